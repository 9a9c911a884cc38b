"""A table of stored actions: all of the official episodes, and few of the fresh ones."""

import numpy as np
import pytest
import torch

from minitouch_bench.evaluation.engine import SILENT
from minitouch_bench.leaderboard.fresh import SIGNIFICANCE
from minitouch_bench.leaderboard.play import play_row
from minitouch_bench.tasks.environment import MiniTouchEnv
from tests.evaluation.runs import Here, request, run
from tests.leaderboard.playing import play_few
from tests.leaderboard.synthetic import entry_of, make_submission

OFFICIAL, FRESH = 12, 6  # two lucky episodes of six are still a significant drop


class Table(torch.nn.Module):
    """Find the episode by its first image, then give what once succeeded in it."""

    def __init__(self, keys: torch.Tensor, actions: torch.Tensor) -> None:
        super().__init__()
        self.register_buffer("keys", keys)
        self.register_buffer("actions", actions)
        self.episode, self.step = -1, 0

    def forward(self, image: torch.Tensor, touch: torch.Tensor) -> torch.Tensor:
        if self.episode < 0:
            differences = (self.keys - image.float()).abs().sum(dim=(1, 2, 3))
            self.episode = int(differences.argmin().item())
        action = self.actions[self.episode, min(self.step, self.actions.shape[1] - 1)]
        self.step += 1
        return action[None]


@pytest.fixture
def table(tmp_path) -> bytes:
    """A checkpoint with the actions of the scripted policy in Pushing's official episodes."""
    solved = run(request("scripted", ("pushing",), OFFICIAL), tmp_path / "solved")
    environment = MiniTouchEnv("pushing")
    specs = solved.header.specs()
    images = [torch.from_numpy(environment.reset(seed=spec.seed)[0]["image"]) for spec in specs]
    recorded = [solved.actions[spec.key] for spec in specs]
    actions = np.zeros((OFFICIAL, max(map(len, recorded)), 4))
    for row, one in zip(actions, recorded, strict=True):
        row[: len(one)] = one
    module = Table(torch.stack(images).float(), torch.from_numpy(actions).float())
    path = tmp_path / "table.pt"
    with pytest.warns(DeprecationWarning, match=r"torch\.jit"):
        torch.jit.script(module).save(path)
    return path.read_bytes()


def test_fresh_episodes_tell_and_take_the_rank(tmp_path, table, monkeypatch):
    play_few(monkeypatch, OFFICIAL, FRESH)
    submissions = tmp_path / "submissions"
    entry = entry_of(make_submission(submissions, "table", content=table, file="table.pt"))
    row = play_row(entry, Here(), SILENT, directory=tmp_path / "play")
    assert row.drop_p < SIGNIFICANCE
    played = entry.read()
    (official,), (later,) = (runs["table4"] for runs in (played.official, played.fresh))
    assert official["pushing"].success.value == 1
    assert later["pushing"].success.value <= 1 / 2
