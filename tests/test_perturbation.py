import msgspec
import numpy as np
import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.perturbation import (
    UNPERTURBED,
    DrawnConditions,
    Perturbation,
    parse_perturbation,
)
from minitouch_bench.protocol.limits import PolicyLimits
from minitouch_bench.protocol.minitouch import PROTOCOL


def test_conditions_are_read_as_they_are_typed():
    found = parse_perturbation(["vision", "touch"], ["mass=2", "camera=-5:5"])
    assert found == Perturbation(without=("touch", "vision"), mass=(2.0, 2.0), camera=(-5.0, 5.0))
    found = parse_perturbation(["vision"], ["force-noise=3"])
    assert found == Perturbation(without=("vision",), force_noise=3.0)
    assert parse_perturbation([], ["delay=1:3"]) == Perturbation(delay=(1, 3))
    assert parse_perturbation([], []) == UNPERTURBED


@pytest.mark.parametrize(
    ("without", "changes", "says"),
    [
        (["smell"], [], "no sense 'smell'; there are touch, forces, vision"),
        ([], ["weight=2"], "no condition 'weight'; there are noise, force-noise, mass"),
        ([], ["mass"], "'mass' is no condition; write mass=2 or mass=0.5:2"),
        ([], ["noise=1:2"], "is no condition; write noise=2$"),
        ([], ["delay=1.5"], "'delay=1.5' is no condition; write delay=2 or delay=1:3"),
        ([], ["mass=2:1"], "mass is 0.01 to 100 times, the smaller value first"),
        ([], ["mass=2", "mass=3"], "'mass' is given twice"),
        ([], ["noise=-1"], "noise is 0 to 255 gray levels"),
        ([], ["delay=1000000"], "delay is 0 to 100 control steps"),
        ([], ["light=-1"], "light is 0 to 100 times"),
        ([], ["light=nan"], "light is 0 to 100 times"),
        (["vision"], ["noise=1"], "--without vision"),
        (["touch"], ["force-noise=1"], "--without touch"),
        (["forces"], ["force-noise=1"], "--without forces"),
    ],
)
def test_what_means_nothing_is_refused(without, changes, says):
    with pytest.raises(UsageError, match=says):
        parse_perturbation(without, changes)


def test_what_is_as_usual_is_not_written():
    changes = ["mass=1", "friction=1:1", "camera=0", "delay=0", "grip=1", "noise=0", "light=0"]
    found = parse_perturbation([], changes)
    assert msgspec.json.encode(found) == b'{"light":[0.0,0.0]}'


def test_a_draw_is_from_the_range_and_depends_on_no_other_condition():
    few, all_of_them = Perturbation(camera=(-5.0, 5.0)), Perturbation(
        mass=(0.5, 2.0), camera=(-5.0, 5.0), delay=(1, 3), grip=(0.5, 1.0), light=(0.0, 0.5)
    )  # fmt: skip
    drawn = [
        [one.draw(np.random.default_rng(seed)) for one in (few, all_of_them)] for seed in range(50)
    ]
    assert all(one == DrawnConditions(camera=other.camera) for one, other in drawn)
    masses = [other.mass for _, other in drawn]
    assert 0.5 <= min(masses) < 0.7
    assert 1.8 < max(masses) <= 2.0
    assert {other.delay for _, other in drawn} == {1, 2, 3}
    assert all(0.5 <= other.grip <= 1.0 for _, other in drawn)


def test_processor_time_is_what_the_longest_episode_may_take():
    longest = max(task.max_steps for task in PROTOCOL.tasks)
    assert PolicyLimits(load_timeout_s=7.0, act_timeout_s=0.5).cpu_s == 7 + longest / 2
