"""A table of stored actions: all of the official episodes, and none of the fresh ones."""

import numpy as np
import pytest
import torch

from minitouch_bench.episode import Role
from minitouch_bench.leaderboard.proof import fresh_seed
from minitouch_bench.leaderboard.proving import DonePart, Prover
from minitouch_bench.leaderboard.submission import ALL_TASKS
from minitouch_bench.tasks.environment import MiniTouchEnv
from tests.evaluation.runs import Here, run
from tests.evaluation.runs import request as wanted_run
from tests.leaderboard.synthetic import checkpoint_of, findings_of

PLACE = "seed-0/table4"
CHECKPOINT = "checkpoints/seed-0/final/table.pt"
OFFICIAL, FRESH = 20, 8  # four lucky episodes of eight are still a significant drop


class Table(torch.jit.ScriptModule):
    """Find the episode by its first image, then give what once succeeded in it.

    The fresh seeds follow from the file's bytes: the code is a text, as that of a class holds its
    source's path.
    """

    def __init__(self, keys: torch.Tensor, actions: torch.Tensor) -> None:
        super().__init__()
        self.register_buffer("keys", keys)
        self.register_buffer("actions", actions)
        self.episode = torch.jit.Attribute(-1, int)
        self.step = torch.jit.Attribute(0, int)
        self.define(FORWARD)


FORWARD = """
def forward(self, image: Tensor, touch: Tensor) -> Tensor:
    if self.episode < 0:
        differences = (self.keys - image.float()).abs().sum(dim=(1, 2, 3))
        self.episode = int(differences.argmin().item())
    action = self.actions[self.episode, min(self.step, self.actions.shape[1] - 1)]
    self.step += 1
    return action[None]
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A run of the table as if it were a submission's."""
    directory = tmp_path_factory.mktemp("table") / "submissions" / "table"
    (directory / CHECKPOINT).parent.mkdir(parents=True)
    solved = run(wanted_run("scripted", ("pushing",), OFFICIAL), directory.parent / "solved")
    environment = MiniTouchEnv("pushing")
    specs = solved.header.specs()
    images = [torch.from_numpy(environment.reset(seed=spec.seed)[0]["image"]) for spec in specs]
    keys = torch.stack(images).float()
    recorded = [solved.actions[spec.key] for spec in specs]
    actions = np.zeros((OFFICIAL, max(map(len, recorded)), 4))
    for row, one in zip(actions, recorded, strict=True):
        row[: len(one)] = one
    table = Table(keys, torch.from_numpy(actions).float())
    with pytest.warns(DeprecationWarning, match="torch.jit"):
        torch.jit.save(table, directory / CHECKPOINT)

    wanted = wanted_run(str(directory / CHECKPOINT), ("pushing",), OFFICIAL)
    done = run(wanted, directory / PLACE)
    file = checkpoint_of(directory, 0, Role.FINAL, ALL_TASKS, "table.pt")
    return findings_of(directory, done, file)


def test_it_succeeds_officially_and_gives_the_same_actions_when_run_again(found):
    assert all(episode.success for episode in found.runs[PLACE].rows)
    prover = Prover(found, Here(), rng=np.random.default_rng(0))
    prover.run_again(3)
    assert not prover.problems


def test_fresh_episodes_tell(found):
    prover = Prover(found, Here(), done=DonePart("a phrase"))
    fresh = prover.run_fresh(FRESH)
    (problem,) = prover.problems
    assert "pushing: success 1.000 officially" in str(problem)
    assert "fits the official episodes" in str(problem)
    (result,) = fresh.results[PLACE]
    assert result.fresh <= 1 / 2
    assert fresh.seeds[PLACE] == fresh_seed(found.runs[PLACE].header.policy.digest, "a phrase")
