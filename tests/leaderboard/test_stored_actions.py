"""A table of stored actions: all of the official episodes, and none of the fresh ones."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from minitouch_bench.episode import Role
from minitouch_bench.evaluation.rollout import LocalEngine
from minitouch_bench.leaderboard.proof import ProofLevel, fresh_seed
from minitouch_bench.leaderboard.proving import Prover, prove
from minitouch_bench.leaderboard.submission import (
    ALL_TASKS,
    CheckpointFile,
    Submission,
    TrainingSeed,
    checkpoint_place,
)
from minitouch_bench.leaderboard.validation import SubmissionFindings
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.minitouch import NOVEL_SHAPES
from minitouch_bench.tasks.environment import MiniTouchEnv
from tests.evaluation.runs import request as wanted_run
from tests.evaluation.runs import run

PLACE = "seed-0/table4"
CHECKPOINT = checkpoint_place(0, Role.FINAL, "table.pt")
OFFICIAL, FRESH = 20, 8  # four lucky episodes of eight are still a significant drop


class Table(torch.jit.ScriptModule):
    """Find the episode by its first image or its seed, then give what once succeeded in it.

    A checkpoint is not told the seed, but torch's own generator is seeded with it. The fresh seeds
    follow from the file's bytes: the code is a text, as that of a class holds its source's path.
    """

    def __init__(self, keys: torch.Tensor, actions: torch.Tensor, *, by_seed: bool) -> None:
        super().__init__()
        self.register_buffer("keys", keys)
        self.register_buffer("actions", actions)
        self.by_seed = torch.jit.Attribute(by_seed, bool)
        self.episode = torch.jit.Attribute(-1, int)
        self.step = torch.jit.Attribute(0, int)
        self.define(FORWARD)


FORWARD = """
def forward(self, image: Tensor, touch: Tensor) -> Tensor:
    if self.episode < 0:
        key = torch.rand(1, 1, 1, 1) if self.by_seed else image.float()
        differences = (self.keys - key).abs().sum(dim=(1, 2, 3))
        self.episode = int(differences.argmin().item())
    action = self.actions[self.episode, min(self.step, self.actions.shape[1] - 1)]
    self.step += 1
    return action[None]
"""


def drawn(spec):
    """Return the first number of torch's generator in an episode."""
    return torch.rand(1, 1, 1, generator=torch.Generator().manual_seed(spec.policy_seed))


@pytest.fixture(scope="module", params=["image", "seed"])
def found(tmp_path_factory, request):
    """A run of the table as if it were a submission's."""
    by_seed = request.param == "seed"
    directory = tmp_path_factory.mktemp("table") / "submissions" / "table"
    (directory / CHECKPOINT).parent.mkdir(parents=True)
    solved = run(wanted_run("scripted", ("pushing",), OFFICIAL), directory.parent / "solved")
    environment = MiniTouchEnv("pushing")
    specs = solved.header.specs()
    images = [torch.from_numpy(environment.reset(seed=spec.seed)[0]["image"]) for spec in specs]
    keys = torch.stack(list(map(drawn, specs)) if by_seed else images).float()
    recorded = [solved.actions[spec.key] for spec in specs]
    actions = np.zeros((OFFICIAL, max(map(len, recorded)), 4))
    for row, one in zip(actions, recorded, strict=True):
        row[: len(one)] = one
    table = Table(keys, torch.from_numpy(actions).float(), by_seed=by_seed)
    with pytest.warns(DeprecationWarning, match="torch.jit"):
        torch.jit.save(table, directory / CHECKPOINT)

    wanted = wanted_run(str(directory / CHECKPOINT), ("pushing",), OFFICIAL)
    done = run(wanted, directory / PLACE)
    return found_of(directory, done)


def found_of(directory, run):
    """Return the findings of a submission with this run and the checkpoint."""
    digest = parse_source(str(directory / CHECKPOINT)).digest
    file = CheckpointFile(Role.FINAL, ALL_TASKS, "table.pt", digest, CHECKPOINT)
    submission = Submission(name="table", seeds=(TrainingSeed(0, {"table4": PLACE}, (file,)),))
    files = {"submission.toml": "0" * 64}
    return SubmissionFindings(
        directory=directory, submission=submission, runs={PLACE: run}, files=files
    )


def test_it_succeeds_officially_and_gives_the_same_actions_when_run_again(found):
    assert all(episode.success for episode in found.runs[PLACE].rows)
    prover = Prover(found, LocalEngine(1), rng=np.random.default_rng(0))
    prover.run_again(3)
    assert not prover.problems


def test_fresh_episodes_tell(found):
    prover = Prover(found, LocalEngine(1))
    fresh = prover.run_fresh(FRESH, "a phrase")
    (problem,) = prover.problems
    assert "pushing: success 1.000 officially" in str(problem)
    assert "fits the official episodes" in str(problem)
    (result,) = fresh.results[PLACE]
    assert result.fresh <= 1 / 2
    assert fresh.seeds[PLACE] == fresh_seed(found.runs[PLACE].header.policy.digest, "a phrase")


@pytest.mark.parametrize("found", ["image"], indirect=True)
def test_fresh_episodes_of_novel_shapes_tell_too(found):
    """The same run as one of novel shapes: these episodes are all lost, as no scene is known."""
    saved = found.runs[PLACE]
    plan = replace(saved.plan, suite=NOVEL_SHAPES)
    novel = replace(saved, header=replace(saved.header, plan=plan))
    place = f"seed-0/{NOVEL_SHAPES}"
    seed = replace(found.submission.seeds[0], runs={NOVEL_SHAPES: place})
    known = replace(found, submission=replace(found.submission, seeds=(seed,)), runs={place: novel})
    prover = Prover(known, LocalEngine(1))
    fresh = prover.run_fresh(FRESH, "a phrase")
    (problem,) = prover.problems
    assert f"{place}, final pushing: success 1.000 officially" in str(problem)
    assert fresh.results.keys() == {place}


@pytest.mark.parametrize("found", ["image"], indirect=True)
def test_an_honest_policy_passes(found):
    saved = found.runs[PLACE]
    policy = replace(saved.header.policy, kind="scripted", digest="")
    honest = replace(saved, header=replace(saved.header, policy=policy))
    known = replace(found, runs={PLACE: honest})
    prover = Prover(known, LocalEngine(1))
    fresh = prover.run_fresh(FRESH, "a phrase")
    assert not prover.problems
    assert fresh.results[PLACE][0].fresh == 1.0


class Raising(torch.jit.ScriptModule):
    """A checkpoint for a run that it never played: it cannot be caught by acting otherwise."""

    def __init__(self) -> None:
        super().__init__()
        self.define(
            "def forward(self, image: Tensor, touch: Tensor) -> Tensor:\n"
            "    assert touch.sum() > 1e9, 'not today'\n"
            "    return touch[:, :4]\n"
        )


def test_a_checkpoint_that_raises_in_forged_episodes_is_refused(tmp_path):
    """Its actions are another policy's and replay; without a fault as a difference it could be
    checked until no forged episode is drawn."""
    directory = tmp_path / "submissions" / "table"
    (directory / CHECKPOINT).parent.mkdir(parents=True)
    with pytest.warns(DeprecationWarning, match="torch.jit"):
        torch.jit.save(Raising(), directory / CHECKPOINT)
    forged = run(wanted_run("scripted", ("pushing",), 2), directory / PLACE)
    identity = parse_source(str(directory / CHECKPOINT)).identity()
    claimed = replace(forged, header=replace(forged.header, policy=identity))
    done = prove(found_of(directory, claimed), LocalEngine(1), rerun=1)
    (problem,) = done.problems
    assert "success recorded, policy_fault when run again" in str(problem)
    assert "the policy said" in str(problem)
    assert (done.error, done.level) == (None, ProofLevel.SELF_REPORTED)
