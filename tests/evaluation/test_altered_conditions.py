"""Episodes under other conditions than the protocol's, for real."""

import numpy as np
import pybullet
import pytest

from minitouch_bench.api import evaluate
from minitouch_bench.commands.verify import verify
from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.rollout import AlteredSenses
from minitouch_bench.perturbation import UNPERTURBED, Perturbation
from minitouch_bench.policies.policy import Isolation, IsolationOptions
from minitouch_bench.simulation.observation import FORCES
from minitouch_bench.tasks.environment import MiniTouchEnv

TRUSTED = IsolationOptions(Isolation.PROCESS, trust=True)
ACTION = np.array([0.6, 0.1, -1.0, 0.0], np.float32)


def observation(level):
    return {
        "image": np.full((1, 84, 84), level, np.uint8),
        "touch": np.full(11, level, np.float32),
    }


def test_a_sense_stays_as_it_was_at_the_reset():
    senses = AlteredSenses(Perturbation(without=("forces", "vision")), seed=0)
    senses.alter(observation(1))
    altered = senses.alter(observation(2))
    assert (altered["image"] == 1).all()
    assert (altered["touch"][FORCES] == 1).all()
    assert (altered["touch"][:5] == 2).all()


def test_noise_comes_from_the_episodes_seed_and_leaves_the_observation_alone():
    perturbation, given = Perturbation(noise=20.0, force_noise=3.0), observation(100)
    first, again, other = (AlteredSenses(perturbation, seed).alter(given) for seed in (0, 0, 1))
    assert (given["image"] == 100).all()
    assert (given["touch"] == 100).all()
    assert np.array_equal(first["image"], again["image"])
    assert not np.array_equal(first["image"], other["image"])
    assert 18 < first["image"].astype(float).std() < 22
    assert (first["touch"][:5] == 100).all()
    assert (first["touch"][FORCES] != 100).all()


@pytest.mark.parametrize(
    "perturbation",
    [
        Perturbation(mass=(0.01, 0.01)),
        Perturbation(friction=(0.01, 0.01)),
        Perturbation(camera=(9, 9)),
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


def test_what_changes_the_senses_alone_leaves_the_world_as_it_is():
    """Pick-up's shapes have moments of inertia from their files."""

    def play(perturbation):
        environment = MiniTouchEnv("pick-up", perturbation=perturbation)
        environment.reset(seed=3)
        object_ = environment.task.target_body
        states = []
        for _ in range(40):
            x, y, z = environment.task.object_state(environment.client)[:3]
            hand = environment.arm.position
            toward = np.array([10 * (x - hand[0]), 10 * (y - hand[1]), 10 * (z - hand[2]), 0.0])
            environment.step(toward.astype(np.float32))
            states.append(environment.client.pose(object_))
        environment.close()
        return states

    standard = play(UNPERTURBED)
    assert standard[0] != standard[-1]  # it was pushed
    assert play(Perturbation(without=("forces",), noise=10.0)) == standard


def test_twice_the_mass_has_twice_the_moments_of_inertia():
    def dynamics(perturbation):
        environment = MiniTouchEnv("pick-up", perturbation=perturbation)
        environment.reset(seed=3)
        object_, client = environment.task.target_body, environment.client
        mass, _, moments, *_ = pybullet.getDynamicsInfo(object_, -1, physicsClientId=client._id)
        environment.close()
        return mass, *moments

    twice = dynamics(Perturbation(mass=(2.0, 2.0)))
    assert twice == pytest.approx([2 * one for one in dynamics(UNPERTURBED)])


def test_a_run_says_its_conditions_and_can_be_verified(tmp_path):
    options = {"suite": "smoke", "tasks": "pushing,opening", "episodes": 1}
    altered = {"without": ["touch"], "perturb": ["mass=0.5:2"], "output": tmp_path / "run"}
    run = evaluate("random", **options, **altered)
    assert run.header.unofficial_because[-2:] == ("without touch", "mass 0.5 to 2 times")
    verify(tmp_path / "run", workers="1")
    other = evaluate("random", **options)
    assert [row.seed for row in run.rows] == [row.seed for row in other.rows]
    assert run.digest != other.digest


@pytest.mark.usefixtures("importable")
@pytest.mark.parametrize(
    "perturbation",
    [
        Perturbation(without=("vision",), force_noise=3.0, friction=(0.01, 0.01)),
        Perturbation(without=("forces",), noise=20.0, mass=(0.5, 2.0), camera=(9.0, 9.0)),
    ],
    ids=lambda perturbation: ", ".join(perturbation.in_words()),
)
def test_a_run_under_a_condition_is_run_again_under_it(tmp_path, perturbation, capsys):
    options = perturbation.as_options()
    spelled = dict(zip(options[::2], options[1::2], strict=True))
    evaluate(
        "misbehaved:Sensitive",
        tasks="pick-up",
        episodes=1,
        workers=1,
        trust=True,
        without=spelled.get("--without"),
        perturb=spelled.get("--perturb"),
        output=tmp_path / "run",
    )
    verify(tmp_path / "run", rerun=1, workers="1", trust=True)
    assert "1 episodes run again" in capsys.readouterr().out


@pytest.mark.parametrize(
    "policies", [{"policy": "scripted"}, {"policy": "zero", "exploration": "scripted"}]
)
def test_the_scripted_policy_has_no_senses_to_change(policies):
    with pytest.raises(UsageError, match="reads the simulator"):
        evaluate(**policies, without="vision")
