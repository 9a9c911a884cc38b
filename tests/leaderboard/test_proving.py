"""Replaying and running again: real episodes in the simulator, a few of them."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from minitouch_bench.documents import write_json
from minitouch_bench.errors import IncompleteCheckError
from minitouch_bench.evaluation.engine import EngineOptions
from minitouch_bench.evaluation.local_engine import LocalEngine
from minitouch_bench.leaderboard.proof import (
    FreshProof,
    ProofLevel,
    find_proof,
    level_of,
    make_proof,
    proof_path,
    read_proof,
    write_proof,
)
from minitouch_bench.leaderboard.submission import Submission, TrainingSeed
from minitouch_bench.leaderboard.validation import Verdict, validate
from minitouch_bench.records import Outcome, Role
from minitouch_bench.runs.run import read_run, run_json
from minitouch_bench.verification.fresh import FreshResult
from minitouch_bench.verification.problems import Problem
from minitouch_bench.workflows import Callbacks, ignore
from minitouch_bench.workflows.prover import Prover
from minitouch_bench.workflows.proving import UNCHECKED, prove, validate_submission, within
from tests.altered import edit_actions
from tests.evaluation.runs import request, run

PLACE = "seed-0/table4"


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return run(request("scripted", ("opening",), 2), tmp_path_factory.mktemp("run") / "run")


@pytest.fixture
def verdict(finished, tmp_path):
    """A run of two episodes as if it were a submission's: only its replay is looked at here."""
    directory = tmp_path / "submissions" / "scripted"
    place = directory / PLACE
    place.mkdir(parents=True)
    shutil.copy(finished.directory / "actions.npz", place)
    (place / "run.json").write_bytes(run_json(finished))
    submission = Submission(
        name="scripted",
        method="scripted",
        modalities=("state",),
        seeds=(TrainingSeed(0, {"table4": PLACE}),),
    )
    return Verdict(directory, submission, {PLACE: read_run(place)}, (), {"run.json": "0" * 64})


@pytest.fixture
def prover(verdict):
    return Prover(verdict, LocalEngine(1), np.random.default_rng(3))


def test_an_honest_run_replays(prover):
    done = []
    dataclasses.replace(prover, on_record=done.append).replay()
    assert not prover.problems
    assert len(done) == 2


def test_swapped_actions_do_not_give_the_figures(verdict, prover):
    def swap(actions):
        actions["opening/0"], actions["opening/1"] = actions["opening/1"], actions["opening/0"]

    edit_actions(verdict.directory / PLACE, swap)
    prover.replay()
    found = [str(problem) for problem in prover.problems]
    assert any("opening/0" in line and "do not give these values" in line for line in found)


def test_one_changed_bit_of_an_action_is_found(verdict, prover):
    def nudge(actions):
        actions["opening/1"][3, 0] = np.nextafter(actions["opening/1"][3, 0], np.float32(0))

    edit_actions(verdict.directory / PLACE, nudge)
    prover.replay()
    assert any("opening/1" in str(problem) for problem in prover.problems)


def test_episodes_run_again_with_the_policy_give_the_same_actions(prover):
    prover.run_again(1)
    assert not prover.problems


class SlowEngine(LocalEngine):
    """A machine on which every episode of a policy is late. The first is played for all."""

    def run(self, source, specs):
        (record,) = super().run(source, specs[:1])
        for spec in specs:
            late = {"spec": spec, "outcome": Outcome.POLICY_FAULT, "fault": "it is late"}
            yield dataclasses.replace(record, **late)


def test_a_policy_that_fails_on_a_slower_machine_is_not_accused(verdict):
    slow = Prover(verdict, SlowEngine(1), np.random.default_rng(3))
    with pytest.raises(IncompleteCheckError, match=r"1 episodes end .* opening/[01]: it is late"):
        slow.run_again(1)
    assert not slow.problems


def test_failing_on_purpose_in_unknown_scenes_is_a_drop(verdict):
    prover = Prover(verdict, SlowEngine(1), np.random.default_rng(3))
    prover.run_fresh(60, "a phrase")
    assert "60 fresh episodes end by a policy fault" in str([*prover.problems][-1])


def with_policy(verdict, **changes):
    """Return the submission with another policy in its run."""
    run = verdict.runs[PLACE]
    policy = dataclasses.replace(run.header.policy, **changes)
    changed = dataclasses.replace(run, header=dataclasses.replace(run.header, policy=policy))
    return dataclasses.replace(verdict, runs={PLACE: changed})


@pytest.mark.parametrize(
    "policy",
    [
        {"kind": "native", "digest": "0" * 64},
        # The address in a stranger's run is not contacted.
        {"kind": "remote", "source": "http://127.0.0.1:1"},
    ],
)
def test_a_checkpoint_that_is_not_there_cannot_be_run_again(verdict, policy):
    prover = Prover(with_policy(verdict, **policy), LocalEngine(1), np.random.default_rng(3))
    with pytest.raises(IncompleteCheckError, match="checkpoint of seed 0 is not in the submission"):
        prover.run_again(1)


def test_what_was_replayed_is_proved_where_the_checkpoint_is_missing(verdict):
    changed = with_policy(verdict, kind="native", digest="0" * 64)
    with pytest.raises(IncompleteCheckError, match="not in the submission"):
        prove(changed, rerun=1, engine=EngineOptions(workers=1))
    assert find_proof(changed.directory, changed.files).level is ProofLevel.REPLAYED


# Proofs


def test_a_proof_counts_for_the_very_bytes_alone(sound, tmp_path):
    verdict = validate(sound)
    proof = make_proof(verdict.files, ProofLevel.REPLAYED)
    path = tmp_path / "_proofs" / "hac.json"
    write_proof(proof, path)
    assert read_proof(path) == proof
    assert level_of(verdict.runs, proof) is ProofLevel.REPLAYED
    assert level_of(verdict.runs, None) is ProofLevel.SELF_REPORTED


def test_a_proof_that_an_older_version_wrote_is_read(sound, tmp_path):
    """It holds sketches of the actions, which nothing uses now."""
    proof, path = make_proof(validate(sound).files, ProofLevel.RERUN, 50), tmp_path / "hac.json"
    document = {**json.loads(write_json(proof)), "sketches": {PLACE: [0.25, -1.5]}}
    path.write_text(json.dumps(document))
    assert read_proof(path) == proof


@pytest.mark.parametrize("other", [f"{PLACE}/run.json", "submission.toml"])
def test_a_proof_of_other_bytes_is_ignored(submission, other):
    verdict = validate(submission)
    proof = make_proof(verdict.files, ProofLevel.RERUN, 5)
    write_proof(proof, proof_path(submission))
    assert find_proof(verdict.directory, verdict.files) == proof
    assert level_of(verdict.runs, proof) is ProofLevel.RERUN
    file = submission / other
    file.write_bytes(file.read_bytes() + b"\n")
    assert find_proof(submission, validate(submission).files) is None


@pytest.mark.parametrize("rerun", [0, 1])
def test_a_weaker_proof_does_not_replace_a_stronger_one(verdict, rerun):
    """The second time by a maintainer who only replays, or runs less again."""
    known = make_proof(verdict.files, ProofLevel.RERUN, rerun_episodes=5)
    write_proof(known, proof_path(verdict.directory))
    assert prove(verdict, engine=EngineOptions(workers=1), rerun=rerun) == ()
    assert find_proof(verdict.directory, verdict.files) == known


def fresh_proof(verdict, places, episodes):
    drop = FreshResult(Role.FINAL, "pushing", "success", 0.9, 0.88, episodes, 0.4)
    seeds, results = dict.fromkeys(places, 1), dict.fromkeys(places, (drop,))
    fresh = FreshProof("a phrase", episodes, seeds, results)
    return make_proof(verdict.files, ProofLevel.FRESH, 50, fresh)


@pytest.mark.parametrize(
    ("suites", "episodes", "level"),
    [
        (("table4", "novel-shapes"), 20, ProofLevel.FRESH),
        (("table4",), 20, ProofLevel.RERUN),
        (("table4", "novel-shapes"), 19, ProofLevel.RERUN),
    ],
)
def test_a_row_is_fresh_where_each_of_its_runs_has_twenty_fresh_episodes_a_task(
    verdict, suites, episodes, level
):
    both = [f"seed-0/{suite}" for suite in ("table4", "novel-shapes")]
    shown = dataclasses.replace(verdict, runs=dict.fromkeys(both, verdict.runs[PLACE]))
    places = [f"seed-0/{suite}" for suite in suites]
    assert level_of(shown.runs, fresh_proof(verdict, places, episodes)) is level


@pytest.mark.parametrize(("count", "level"), [(1, ProofLevel.RERUN), (20, ProofLevel.FRESH)])
def test_a_few_fresh_episodes_give_no_level(verdict, monkeypatch, count, level):
    fresh = fresh_proof(verdict, [PLACE], count).fresh
    monkeypatch.setattr(Prover, "run_fresh", lambda *_: fresh)
    engine = EngineOptions(workers=1)
    assert prove(verdict, rerun=1, fresh_episodes=count, engine=engine) == ()
    proof = find_proof(verdict.directory, verdict.files)
    assert (proof.level, proof.fresh) == (level, fresh if count == 20 else None)


FRESH_DROP = Problem("seed-0/table4", "success 1.000 officially, 0.000 in 50 fresh episodes")
UNREAD = Problem("seed-0/table4", "it cannot be read", is_unchecked=True)


@pytest.mark.parametrize(
    ("problems", "is_withdrawn"),
    [((FRESH_DROP,), True), ((UNREAD, FRESH_DROP), True), ((UNREAD,), False), ((), False)],
)
def test_a_failed_check_withdraws_an_older_proof(submission, monkeypatch, problems, is_withdrawn):
    level = ProofLevel.RERUN
    write_proof(make_proof(validate(submission).files, level, 5), proof_path(submission))
    found = validate_submission(submission, lambda _: problems)
    assert found.problems == problems
    assert found.withdrawn == (level if is_withdrawn else None)
    runs = validate(submission).runs
    assert level_of(runs, validate(submission).proof) == (
        ProofLevel.SELF_REPORTED if is_withdrawn else level
    )


def test_a_file_too_many_leaves_the_proof(submission):
    write_proof(make_proof(validate(submission).files, ProofLevel.RERUN, 5), proof_path(submission))
    (submission / ".DS_Store").write_bytes(b"of a file manager")
    found = validate_submission(submission, lambda _: ())
    assert ".DS_Store" in str(found.problems[0])
    assert found.withdrawn is None
    assert read_proof(proof_path(submission)).level is ProofLevel.RERUN


@pytest.mark.parametrize("error", UNCHECKED)
def test_a_check_that_could_not_be_made_leaves_the_proof(verdict, monkeypatch, error):
    """Such as of a checkpoint that is gone; the proof was made when it was there."""
    write_proof(make_proof(verdict.files, ProofLevel.RERUN, 5), proof_path(verdict.directory))

    def fail(*_):
        raise error("why")

    monkeypatch.setattr(Prover, "run_again", fail)
    with pytest.raises(IncompleteCheckError, match="why"):
        prove(verdict, rerun=1, engine=EngineOptions(workers=1))
    assert find_proof(verdict.directory, verdict.files).level is ProofLevel.RERUN


def test_what_differs_counts_though_the_check_could_not_be_finished(verdict, monkeypatch):
    def differs_and_ends(prover, _):
        prover.problems.add("seed-0/table4", "it differs")
        raise IncompleteCheckError("the final checkpoint of seed 1 is not in the submission")

    monkeypatch.setattr(Prover, "run_again", differs_and_ends)
    (problem,) = prove(verdict, rerun=1, engine=EngineOptions(workers=1))
    assert problem.what == "it differs"


def test_a_check_ends_when_its_time_is_up(verdict):
    """The older proof stays, and none is made."""
    played = []
    with pytest.raises(IncompleteCheckError, match="not finished within 1e-09 s"):
        prove(
            verdict,
            engine=EngineOptions(workers=1),
            time_limit_s=1e-9,
            callbacks=Callbacks(episode=played.append),
        )
    assert len(played) == 1
    assert find_proof(verdict.directory, verdict.files) is None


def test_what_was_replayed_in_time_is_proved(verdict, monkeypatch):
    def too_slow(prover, _):
        within(0.0, ignore)(None)

    monkeypatch.setattr(Prover, "run_again", too_slow)
    with pytest.raises(IncompleteCheckError, match="--time-limit"):
        prove(verdict, rerun=1, engine=EngineOptions(workers=1))
    assert find_proof(verdict.directory, verdict.files).level is ProofLevel.REPLAYED


def test_a_proof_lies_beside_the_submissions(submission):
    assert proof_path(submission) == submission.parent / "_proofs" / "hac.json"


def test_a_remote_policy_stays_remote(verdict):
    saved = verdict.runs[PLACE]
    policy = dataclasses.replace(saved.header.policy, kind="remote")
    saved = dataclasses.replace(saved, header=dataclasses.replace(saved.header, policy=policy))
    remote = dataclasses.replace(verdict, runs={PLACE: saved})
    assert level_of(remote.runs, make_proof(remote.files, ProofLevel.RERUN)) is ProofLevel.REMOTE


def test_a_proof_inside_a_submission_is_an_unknown_file(submission):
    (submission / "proof.json").write_text("{}")
    assert any("proof.json" in str(problem) for problem in validate(submission).problems)
