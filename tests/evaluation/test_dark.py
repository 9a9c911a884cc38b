"""The suite with the light off: what a policy sees, what is official, and what is refused."""

import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.evaluation.rollout import run_episode
from minitouch_bench.perturbation import UNPERTURBED, Perturbation, parse_perturbation
from minitouch_bench.protocol.minitouch import DARK
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.tasks.environment import MiniTouchEnv
from tests.evaluation.misbehaved import Still


class Watching(Still):
    """Remembers the brightest pixel that it is shown, and is at fault at its third step."""

    brightest = -1

    def act(self, observation):
        self.brightest = max(self.brightest, int(observation["image"].max()))
        action = super().act(observation)
        return action if self.steps < 3 else action[:1]


@pytest.mark.parametrize(
    ("suite", "changes", "is_black"),
    [(DARK, (), True), (DARK, ("light=1",), False), ("table4", ("light=0",), True)],
)
def test_the_suite_and_the_condition_darken_every_picture(suite, changes, is_black):
    plan = make_plan(suite, ["opening"], conditions=parse_perturbation((), changes))
    world, policy = MiniTouchEnv("opening", perturbation=plan.conditions_in_light()), Watching()
    run_episode(world, policy, plan.specs()[0])
    world.close()
    assert (policy.brightest == 0) is is_black
    assert policy.brightest >= 0


def test_dark_is_official_and_another_light_is_not():
    assert make_plan(DARK).why_unofficial() == ()
    same = make_plan(DARK, conditions=Perturbation(light=(0.0, 0.0)))
    assert same == make_plan(DARK)
    assert make_plan("table4", conditions=Perturbation(light=(1.0, 1.0))).conditions == UNPERTURBED
    lit = make_plan(DARK, conditions=Perturbation(light=(1.0, 1.0)))
    assert lit.why_unofficial() == ("light on",)
    assert "--perturb light=1" in " ".join(lit.as_options())
    assert lit.mistake() == ""


def test_pushing_is_refused_with_the_reason():
    with pytest.raises(UsageError, match="the target of pushing cannot be felt"):
        make_plan(DARK, ["pushing"])
