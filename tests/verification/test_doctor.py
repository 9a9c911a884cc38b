from contextlib import closing

import pytest

from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.verification import doctor
from minitouch_bench.verification.doctor import golden_bits, recorded, trial_episodes


def test_the_trial_has_contact_and_every_task():
    specs, recording = trial_episodes()
    assert {spec.task for spec in specs} == set(TASK_NAMES)
    assert set(recording.actions) == {*specs}
    with closing(EpisodeRunner(recording)) as runner:
        touched = [runner.run(spec).trace.contact_ticks.any() for spec in specs]
    assert sum(touched) >= 2


@pytest.mark.parametrize("task", TASK_NAMES)
def test_the_golden_episode_is_as_recorded(task):
    assert golden_bits(task) == recorded()[task], "simulation changed: raise the task's revision"


@pytest.mark.parametrize(
    ("task", "bits"),
    [
        ("playing", "d86770533d74c0c3659a80eb2a803b36a5ec752fbe733015fb1576b57a35cdef"),
        ("pushing", "37bb02b87be75dc741a7cf0f103cc1f829fbb89631cd802670fd42609e406f98"),
        ("pick-up", "ea156cee5eb58382bc7afcfc039eb9e66ef375e6c4dab52b3fbcc5564b62257c"),
    ],
)
def test_a_held_out_shape_moves_as_recorded(task, bits):
    assert golden_bits(task, "held-out") == bits, "simulation changed: raise the task's revision"


def test_other_bits_are_found(monkeypatch):
    monkeypatch.setattr(doctor, "golden_bits", lambda task: "0" * 64)
    monkeypatch.setattr(doctor.LocalEngine, "run", lambda *_: iter(()))
    found = {check.name: check.verdict for check in doctor.examine(1)}
    assert found["reference bits"] is doctor.CheckResult.NOTE
    assert found["order and workers"] is doctor.CheckResult.FAIL
