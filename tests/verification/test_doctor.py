import pytest

from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL, TASK_NAMES
from minitouch_bench.verification import doctor
from minitouch_bench.verification.doctor import CheckResult, golden_bits, recorded, trial_episodes


def test_the_trial_has_contact_and_every_task():
    specs, recording = trial_episodes()
    assert {spec.task for spec in specs} == set(TASK_NAMES)
    assert set(recording.actions) == {*specs}
    runner = EpisodeRunner(recording)
    records = [runner.run(spec) for spec in specs]
    runner.close()
    assert sum(record.trace.contact_ticks.any() for record in records) >= 2


@pytest.mark.parametrize("found", [{"a": "1"}, {"a": "1", "b": "3"}])
def test_an_episode_that_is_missing_or_other_is_named(found):
    check = doctor._same({"a": "1", "b": "2"}, found, "with 2 workers")
    assert check.verdict is CheckResult.FAIL
    assert check.text.endswith(": b")


@pytest.mark.parametrize(
    ("workers", "words"), [(1, "in 13 min with 1 worker,"), (2, "7 min with 2 workers,")]
)
def test_the_time_of_an_evaluation_is_that_of_the_workers_asked_for(workers, words):
    assert words in doctor._speed(100.0, workers).text


def test_every_task_has_its_golden_digest():
    assert set(recorded()) == set(TASK_NAMES)


@pytest.mark.parametrize("task", TASK_NAMES)
def test_the_golden_episode_is_as_recorded(task):
    golden = recorded()[task]
    assert golden.task_digest == PROTOCOL.task_digest(task, MAIN_SUITE), (
        "a value of the protocol changed: record the golden digests again"
    )
    assert golden_bits(task) == golden.bits, "simulation changed: raise the task's revision"
