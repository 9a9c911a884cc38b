import json
from importlib.resources import files

import pytest

from minitouch_bench.protocol.identity import protocol_digest
from minitouch_bench.records import TASK_NAMES
from minitouch_bench.verification import doctor
from minitouch_bench.verification.doctor import Verdict, reference_bits, trial_episodes


def test_the_trial_has_contact_and_every_task():
    specs, recording = trial_episodes()
    assert {spec.task for spec in specs} == set(TASK_NAMES)
    assert set(recording.actions) == {spec.key for spec in specs}
    runner = doctor.EpisodeRunner(recording)
    records = [runner.run(spec) for spec in specs]
    runner.close()
    assert sum(record.trace.contact_ticks.any() for record in records) >= 2


def test_the_reference_is_of_this_protocol():
    text = files("minitouch_bench.verification").joinpath("reference.json").read_text("utf-8")
    reference = json.loads(text)
    assert reference["protocol_digest"] == protocol_digest(), (
        "the protocol has changed: record the bits of doctor.reference_bits() anew"
    )
    assert len(reference["bits"]) == len(reference_bits()) == 64


@pytest.mark.parametrize("found", [{"a": "1"}, {"a": "1", "b": "3"}])
def test_an_episode_that_is_missing_or_other_is_named(found):
    check = doctor._same("crash", {"a": "1", "b": "2"}, found, "after a crash")
    assert check.verdict is Verdict.FAIL
    assert check.text == "other bits after a crash: b"
