"""Episodes under other conditions than the protocol's, for real."""

import numpy as np
import pytest

from minitouch_bench.api import evaluate
from minitouch_bench.commands.verify import verify
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.rollout import AlteredSenses
from minitouch_bench.perturbation import UNPERTURBED, DrawnConditions, Perturbation
from minitouch_bench.simulation.observation import FORCES
from minitouch_bench.tasks.environment import MiniTouchEnv

LIMIT = 200.0
"""Of forces, in N."""


def observation(level):
    return {
        "image": np.full((1, 84, 84), level, np.uint8),
        "touch": np.full(11, level, np.float32),
    }


def test_observations_are_late_after_their_noise_and_before_a_sense_is_frozen():
    perturbation = Perturbation(without=("forces",), noise=20.0, delay=(2, 2))
    late = AlteredSenses(perturbation, 0, LIMIT, DrawnConditions(delay=2))
    noisy = AlteredSenses(Perturbation(noise=20.0), 0, LIMIT)
    seen = [noisy.alter(observation(level)) for level in range(50, 55)]
    given = [late.alter(observation(level)) for level in range(50, 55)]
    for index, one in enumerate(given):
        assert np.array_equal(one["image"], seen[max(0, index - 2)]["image"])
        assert (one["touch"][:5] == max(50, 48 + index)).all()
        assert (one["touch"][FORCES] == 50).all()


def test_light_multiplies_gray_levels_before_noise_and_saturates():
    for light, level, expected in ((0.0, 90, 0), (0.5, 91, 46), (3.0, 90, 255)):
        perturbation = Perturbation(light=(light, light))
        senses = AlteredSenses(perturbation, 0, LIMIT, DrawnConditions(light=light))
        assert (senses.alter(observation(level))["image"] == expected).all()
    noisy = Perturbation(light=(0.0, 0.0), noise=20.0)
    given = AlteredSenses(noisy, 0, LIMIT, DrawnConditions(light=0.0)).alter(observation(90))
    assert 0 < given["image"].mean() < 20


def test_noise_comes_from_the_episodes_seed_and_leaves_the_observation_alone():
    perturbation, given = Perturbation(noise=20.0, force_noise=3.0), observation(100)
    first, again, other = (
        AlteredSenses(perturbation, seed, LIMIT).alter(given) for seed in (0, 0, 1)
    )
    assert (given["image"] == 100).all()
    assert (given["touch"] == 100).all()
    assert np.array_equal(first["image"], again["image"])
    assert not np.array_equal(first["image"], other["image"])
    assert 18 < first["image"].astype(float).std() < 22
    assert (first["touch"][:5] == 100).all()
    assert (first["touch"][FORCES] != 100).all()


def test_noisy_senses_stay_in_the_observation_space():
    environment = MiniTouchEnv("playing")
    limit, space = environment.task.spec.force_limit, environment.observation_space
    environment.close()
    perturbation = Perturbation(noise=255.0, force_noise=1000.0)
    senses = AlteredSenses(perturbation, seed=0, force_limit=limit)
    for level in (0, 1):
        altered = senses.alter(observation(level))
        assert space.contains(altered)
    assert np.abs(altered["touch"][FORCES]).max() == limit


@pytest.mark.parametrize(
    "perturbation",
    [
        Perturbation(mass=(0.01, 0.01)),
        Perturbation(friction=(0.01, 0.01)),
        Perturbation(camera=(9, 9)),
        Perturbation(grip=(0.01, 0.01)),
    ],
)
def test_the_world_differs_and_is_the_same_again(perturbation):
    def play(perturbation):
        environment = MiniTouchEnv("playing", perturbation=perturbation)
        seen, _ = environment.reset(seed=3)
        first, states = seen["image"], []
        for _ in range(12):
            _, _, _, _, info = environment.step(toward(environment))
            states.append(info["object_state"])
        environment.close()
        return first.tobytes() + np.array(states).tobytes()

    def toward(environment):
        x, y, _ = environment.task.object_state(environment.client)
        hand = environment.arm.position
        return np.array([10 * (x - hand[0]), 10 * (y - hand[1]), -1.0, 0.0], np.float32)

    assert play(perturbation) == play(perturbation) != play(UNPERTURBED)


def test_a_run_under_a_condition_is_run_again_under_it(tmp_path, capsys):
    conditions = {
        "without": "forces",
        "perturb": "noise=20,mass=0.5:2,camera=9,delay=1:3,grip=0.5:1",
    }
    options = {"tasks": "pick-up", "episodes": 1, "workers": 1, "output": tmp_path / "run"}
    policy = "misbehaved:Sensitive"
    evaluate(policy, trust=True, **options, **conditions)
    verify(tmp_path / "run", policy=policy, rerun=1, workers="1", trust=True)
    assert "1 episode run again" in capsys.readouterr().out


def test_the_scripted_policy_has_no_senses_to_change():
    for condition in ({"without": "vision"}, {"perturb": "delay=1"}):
        with pytest.raises(UsageError, match="reads the simulator"):
            evaluate("scripted", **condition)
