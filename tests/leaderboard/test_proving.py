"""Proving a submission: real episodes in the simulator, a few of them."""

import dataclasses
import json
import shutil

import numpy as np
import pytest
import torch

from minitouch_bench.episode import Outcome, Role
from minitouch_bench.errors import IncompleteCheckError, InterruptedRunError, IsolationError
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.evaluation.rollout import LocalEngine
from minitouch_bench.files import VARIABLE, write_file
from minitouch_bench.json_io import write_json
from minitouch_bench.leaderboard import proving
from minitouch_bench.leaderboard.proof import (
    FreshProof,
    Proof,
    ProofLevel,
    Values,
    find_proof,
    level_of,
    proof_path,
    read_proof,
)
from minitouch_bench.leaderboard.proving import DonePart, Prover, prove
from minitouch_bench.leaderboard.validation import validate
from minitouch_bench.policies.native import save_native
from minitouch_bench.policies.networks import TouchActor
from minitouch_bench.runs.run import read_run, run_json
from tests.altered import edit_actions, edit_document, nudge, swap
from tests.evaluation.runs import Here, request, run
from tests.leaderboard.synthetic import FRESH_RESULT, VIDEO, checkpoint_of, findings_of, prove_as

PLACE = "seed-0/table4"
REPLAYED, VERIFIED = ProofLevel.REPLAYED, ProofLevel.VERIFIED


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return run(request("scripted", ("opening",), 2), tmp_path_factory.mktemp("run") / "run")


@pytest.fixture
def found(finished, tmp_path, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(tmp_path / "cache"))
    directory = tmp_path / "submissions" / "scripted"
    place = directory / PLACE
    place.mkdir(parents=True)
    shutil.copy(finished.directory / "actions.npz", place)
    (place / "run.json").write_bytes(run_json(finished))
    return findings_of(directory, read_run(place))


def prover(found, engine=None):
    done = DonePart("a phrase")
    return Prover(found, engine or Here(), rng=np.random.default_rng(3), done=done)


@pytest.mark.parametrize("change", [swap, nudge])
def test_other_actions_do_not_give_the_figures(found, change):
    edit_actions(found.directory / PLACE, change)
    checking = prover(found)
    checking.replay()
    lines = [str(problem) for problem in checking.problems]
    assert any("opening/1" in line and "do not give these values" in line for line in lines)


def test_an_honest_run_replays_and_its_policy_gives_the_same_actions(found):
    done = []
    checking = dataclasses.replace(prover(found), on_record=done.append)
    checking.replay()
    checking.run_again(1)
    assert not checking.problems
    assert len(done) == 3


class FailingEngine(Here):
    """An engine on which a policy fails in some episodes; replaying works."""

    def __init__(self, failing, *, is_late=False):
        self.failing, self.is_late = failing, is_late
        self.times = []

    def run(self, source, specs):
        self.times.append(len(specs))
        for spec in specs:
            if isinstance(source, PolicySetup) and self.failing & {spec.key, "all"}:
                (record,) = super().run(source, [spec])
                fault = {"fault": "it fails", "is_late": self.is_late}
                yield dataclasses.replace(record, outcome=Outcome.POLICY_FAULT, **fault)
            else:
                yield from super().run(source, [spec])


@pytest.mark.parametrize("is_late", [False, True])
def test_a_policy_that_fails_in_an_episode_that_went_well_is_refused(found, is_late):
    """Else a forged episode could be tried until it is not drawn."""
    engine = FailingEngine({"opening/1"}, is_late=is_late)
    done = prove(found, engine, rerun=2, fresh=1)
    (problem,) = done.problems
    assert "opening/1: success recorded, policy_fault when run again (it fails)" in str(problem)
    assert done.error is None
    assert engine.times == ([2, 2, 1] if is_late else [2, 2])  # a late one gets another chance


def test_a_policy_that_is_late_everywhere_is_not_accused(found):
    checking = prover(found, FailingEngine({"all"}, is_late=True))
    with pytest.raises(IncompleteCheckError, match=r"2 of 2 episodes .* opening/0: it fails"):
        checking.run_again(2)
    assert not checking.problems


def with_twenty(found):
    """Return the submission as if its run had ten times as many episodes."""
    run = found.runs[PLACE]
    return dataclasses.replace(found, runs={PLACE: dataclasses.replace(run, rows=10 * run.rows)})


def test_failing_on_purpose_in_unknown_scenes_is_a_drop(found):
    checking = prover(with_twenty(found), FailingEngine({"all"}))
    checking.run_fresh(4)
    assert "4 fresh episodes end by a policy fault" in str([*checking.problems][-1])


class BackwardsEngine(FailingEngine):
    def run(self, source, specs):
        yield from reversed([*super().run(source, specs)])


def test_the_order_in_which_fresh_episodes_end_changes_nothing(found, monkeypatch):
    """The seeds' episodes of one number are averaged."""
    tested = []
    monkeypatch.setattr(proving.proof, "drop_together", tested.append)
    for engine in (FailingEngine({"opening/0"}), BackwardsEngine({"opening/0"})):
        prover(found, engine).run_fresh(3)
    assert [*tested[0].values()] == [[Values((1.0, 1.0), (0.0, 1.0, 1.0))]]
    assert tested[0] == tested[1]


def with_policy(found, **changes):
    """Return the submission with another policy in its run."""
    run = found.runs[PLACE]
    policy = dataclasses.replace(run.header.policy, **changes)
    changed = dataclasses.replace(run, header=dataclasses.replace(run.header, policy=policy))
    return dataclasses.replace(found, runs={PLACE: changed})


def test_a_checkpoint_that_is_not_there_cannot_be_run_again(found):
    """What was replayed is proved."""
    done = prove(with_policy(found, kind="native", digest="0" * 64), Here())
    assert "checkpoint of seed 0 is not in the submission" in str(done.error)
    assert not done.passed
    assert find_proof(found.directory, found.files).level is REPLAYED


def test_each_checkpoint_of_a_directory_is_run_again_in_its_own_task(tmp_path):
    directory, files = tmp_path / "submissions" / "hac", []
    folder = directory / "checkpoints" / "seed-0" / "final"
    folder.mkdir(parents=True)
    for seed, task in enumerate(("opening", "pushing")):
        torch.manual_seed(seed)
        save_native(TouchActor(action_size=4), folder / f"{task}.safetensors")
        files.append(checkpoint_of(directory, 0, Role.FINAL, task, f"{task}.safetensors"))
    done = run(request(str(folder), ("opening", "pushing"), 1), tmp_path / "run")
    per_task, played = findings_of(directory, done, *files), []
    checking = dataclasses.replace(prover(per_task), on_record=played.append)
    checking.run_again(2)
    assert not checking.problems
    assert {record.spec.task for record in played} == {"opening", "pushing"}
    paths = [directory / file.path for file in files]
    paths[0].write_bytes(paths[1].read_bytes())
    checking = prover(per_task)
    checking.run_again(2)
    assert "is not the policy of this run" in str(*checking.problems)


@pytest.mark.parametrize("kind", ["remote", "factory"])
def test_a_server_s_or_a_class_s_policy_is_replayed_at_most(found, kind):
    """The address in a stranger's run is not contacted, and no class of it is imported."""
    remote = with_policy(found, kind=kind, source="http://127.0.0.1:1")
    assert prover(remote).count_episodes(20, 50) == 2
    done = prove(remote, Here())
    assert (done.passed, done.level) == (True, REPLAYED)
    assert level_of(remote.runs, fresh_proof(remote, [PLACE], 50)) is REPLAYED


def test_a_submission_is_proved(found):
    done = prove(found, LocalEngine(2), rerun=1, fresh=20)
    assert (done.passed, done.level, done.withdrawn) == (True, VERIFIED, None)
    proof = find_proof(found.directory, found.files)
    assert proof == done.proof
    assert (proof.rerun_episodes, proof.fresh.episodes_per_task) == (1, 20)
    assert proof.fresh.results[PLACE][0].fresh == 1.0


class InterruptedEngine(FailingEngine):
    """An engine that is interrupted when it is to play so many more lists of episodes."""

    def __init__(self, lists):
        super().__init__(set())
        self.lists = lists

    def run(self, source, specs):
        if len(self.times) == self.lists:
            raise KeyboardInterrupt
        yield from super().run(source, specs)


def test_an_interrupted_proof_continues_where_it_was(found, tmp_path):
    places = {"table4": PLACE, "novel-shapes": "seed-0/novel-shapes"}
    seeds = (dataclasses.replace(found.submission.seeds[0], runs=places),)
    submission = dataclasses.replace(found.submission, seeds=seeds)
    runs = dict.fromkeys(places.values(), found.runs[PLACE])
    found = dataclasses.replace(found, submission=submission, runs=runs)
    for lists, played in ((1, [2]), (2, [2, 1]), (2, [1, 20])):  # of six: twice 2, 1 and 20
        engine = InterruptedEngine(lists)
        with pytest.raises(InterruptedRunError, match="The same command continues"):
            prove(found, engine, rerun=1, fresh=20)
        assert engine.times == played
    (kept,) = (tmp_path / "cache" / "proofs").iterdir()
    draw, phases = json.loads(kept.read_bytes())["draw"], []
    engine = FailingEngine(set())
    callbacks = Callbacks(phase=lambda *phase: phases.append(phase))
    done = prove(found, engine, callbacks, rerun=1, fresh=20)
    assert (engine.times, phases) == ([20], [("proof", 20)])
    assert (done.level, done.proof.fresh.draw) == (VERIFIED, draw)
    assert not kept.exists()


def interrupted_after_its_replay(found):
    engine = InterruptedEngine(1)
    with pytest.raises(InterruptedRunError):
        prove(found, engine, rerun=2, fresh=1)
    return engine


def test_no_part_of_a_proof_is_used_for_other_files(found):
    interrupted_after_its_replay(found)
    other = dataclasses.replace(found, files={"submission.toml": "0" * 64})
    assert interrupted_after_its_replay(other).times == [2]


def test_no_part_of_a_proof_is_kept_where_something_differs(found):
    interrupted_after_its_replay(found)
    assert prove(found, FailingEngine({"opening/1"}), rerun=2, fresh=1).problems
    engine = FailingEngine(set())
    prove(found, engine, rerun=2, fresh=1)
    assert engine.times == [2, 2, 1]


# Proofs


def fresh_proof(found, places, episodes, rerun=20):
    seeds, results = dict.fromkeys(places, 1), dict.fromkeys(places, (FRESH_RESULT,))
    fresh = FreshProof("a phrase", episodes, seeds, results)
    return Proof(VERIFIED, found.files, rerun, fresh)


@pytest.mark.parametrize(
    ("name", "level"),
    [("replay-verified", REPLAYED), ("re-run-verified", REPLAYED), ("fresh-verified", VERIFIED)],
)
def test_a_proof_of_an_earlier_level_is_read_as_one_of_the_three(submission, name, level):
    """An earlier proof also holds sketches of the actions, which nothing uses now."""
    found = validate(submission)
    document = json.loads(write_json(fresh_proof(found, found.runs, 50)))
    document |= {"level": name, "version": 1, "sketches": {PLACE: [0.25, -1.5]}}
    write_file(proof_path(submission), json.dumps(document))
    assert validate(submission).level is level


def add_video(submission, content=VIDEO):
    file = submission / PLACE / "videos" / "pushing-0.mp4"
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(content)


@pytest.mark.parametrize("other", [f"{PLACE}/run.json", "submission.toml"])
def test_a_proof_of_other_bytes_is_ignored(submission, other):
    prove_as(submission)
    assert validate(submission).level is VERIFIED
    file = submission / other
    file.write_bytes(file.read_bytes() + b"\n")
    assert validate(submission).proof is None


def test_a_proof_is_about_the_videos_too(submission):
    add_video(submission)
    prove_as(submission)
    assert validate(submission).level is VERIFIED
    add_video(submission, VIDEO + b"another")
    assert validate(submission).proof is None
    shutil.rmtree(submission / PLACE / "videos")
    assert validate(submission).proof is None


def test_an_earlier_proof_holds_whichever_videos_there_are(submission):
    prove_as(submission)
    edit_document(proof_path(submission), lambda proof: proof.update(version=1))
    assert validate(submission).level is VERIFIED
    add_video(submission)
    assert validate(submission).level is VERIFIED
    add_video(submission, b"<html><script>")
    assert "it is not an MP4 video" in str(validate(submission).problems[0])


def test_a_weaker_proof_does_not_replace_a_stronger_one(found):
    known = fresh_proof(found, [PLACE], 50)
    write_file(proof_path(found.directory), write_json(known))
    known_of = dataclasses.replace(found, proof=known)
    assert prove(known_of, Here(), rerun=1, fresh=1).proof == known
    assert find_proof(found.directory, found.files) == known
    done = prove(found, Here(), rerun=1, fresh=1)  # too few fresh episodes for a level
    assert (done.level, done.proof.fresh) == (REPLAYED, None)


@pytest.mark.parametrize(
    ("proved", "episodes", "level"), [(2, 20, VERIFIED), (1, 20, REPLAYED), (2, 19, REPLAYED)]
)
def test_a_row_is_verified_where_each_of_its_runs_has_twenty_fresh_episodes_a_task(
    found, proved, episodes, level
):
    places = [PLACE, "seed-0/novel-shapes"]
    runs = dict.fromkeys(places, found.runs[PLACE])
    assert level_of(runs, fresh_proof(found, places[:proved], episodes)) is level
    assert level_of(runs, None) is ProofLevel.SELF_REPORTED


def proved(found, monkeypatch, step):
    """Prove a submission that has a proof, where running again does this."""
    known = fresh_proof(found, [PLACE], 50)
    write_file(proof_path(found.directory), write_json(known))
    monkeypatch.setattr(Prover, "run_again", step)
    return prove(dataclasses.replace(found, proof=known), Here())


def differs(prover, _):
    prover.problems.add(PLACE, "it differs")


def differs_and_ends(prover, _):
    differs(prover, _)
    raise IncompleteCheckError("a checkpoint is not in the submission")


@pytest.mark.parametrize("step", [differs, differs_and_ends])
def test_what_differs_withdraws_an_older_proof(found, monkeypatch, step, tmp_path):
    done = proved(found, monkeypatch, step)
    assert not [*(tmp_path / "cache" / "proofs").iterdir()]
    assert (done.withdrawn, done.level) == (VERIFIED, ProofLevel.SELF_REPORTED)
    assert (done.problems[0].what, done.error is None) == ("it differs", step is differs)
    assert read_proof(proof_path(found.directory)) is None


@pytest.mark.parametrize("error", [IsolationError, None])
def test_a_check_that_could_not_be_made_leaves_the_proof(found, monkeypatch, error):
    """Such as of a checkpoint that is gone; the proof was made when it was there."""

    def fail(prover, _):
        if error:
            raise error("it cannot be read")
        prover.problems.add(PLACE, "it cannot be read", unchecked=True)

    done = proved(found, monkeypatch, fail)
    assert "it cannot be read" in f"{done.error} {done.problems}"
    assert done.withdrawn is None
    assert find_proof(found.directory, found.files).level is VERIFIED


def test_a_check_ends_when_its_time_is_up(found):
    played = []
    checking = Prover(found, Here(), played.append, time_limit_s=1e-9)
    with pytest.raises(IncompleteCheckError, match="not finished within 1e-09 s"):
        checking.replay()
    assert len(played) == 1
