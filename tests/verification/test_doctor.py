import pytest

from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.verification import doctor
from minitouch_bench.verification.doctor import CheckResult, trial_episodes


def test_the_trial_has_contact_and_every_task():
    specs, recording = trial_episodes()
    assert {spec.task for spec in specs} == set(TASK_NAMES)
    assert set(recording.actions) == {spec.key for spec in specs}
    runner = doctor.EpisodeRunner(recording)
    records = [runner.run(spec) for spec in specs]
    runner.close()
    assert sum(record.trace.contact_ticks.any() for record in records) >= 2


@pytest.mark.parametrize("found", [{"a": "1"}, {"a": "1", "b": "3"}])
def test_an_episode_that_is_missing_or_other_is_named(found):
    check = doctor._same("crash", {"a": "1", "b": "2"}, found, "after a crash")
    assert check.verdict is CheckResult.FAIL
    assert check.text == "other bits after a crash: b"


@pytest.mark.parametrize(
    ("workers", "words"), [(1, "in 13 min with 1 worker,"), (2, "7 min with 2 workers,")]
)
def test_the_time_of_an_evaluation_is_that_of_the_workers_asked_for(workers, words):
    assert words in doctor._speed(100.0, workers).text
