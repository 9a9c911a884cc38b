"""A table of stored actions: all of the official episodes, and few of the fresh ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from minitouch_bench.evaluation.engine import SILENT
from minitouch_bench.leaderboard import fresh
from minitouch_bench.leaderboard import play as entries
from minitouch_bench.leaderboard.fresh import SIGNIFICANCE
from minitouch_bench.leaderboard.play import Entry, play_row
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.tasks.environment import MiniTouchEnv
from tests.evaluation.runs import Here, request, run
from tests.leaderboard.synthetic import make_submission

OFFICIAL, FRESH = 12, 6  # two lucky episodes of six are still a significant drop


class Table(torch.jit.ScriptModule):
    """Find the episode by its first image, then give what once succeeded in it.

    The code is a text, as that of a class holds its source's path, and the fresh seeds follow from
    the file's bytes.
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
        torch.jit.save(module, path)
    return path.read_bytes()


def test_fresh_episodes_tell_and_take_the_rank(tmp_path, table, monkeypatch):
    def small_plan(suite):
        return replace(make_plan(suite), episodes=OFFICIAL, tasks=("pushing",))

    for module in (entries, fresh):
        monkeypatch.setattr(module, "make_plan", small_plan)
    monkeypatch.setattr(fresh, "FRESH_EPISODES", FRESH)
    directory = make_submission(tmp_path / "submissions", "table", content=table)
    text = (directory / "submission.toml").read_text()
    (directory / "submission.toml").write_text(text.replace("hac.safetensors", "table.pt"))
    place = directory / "checkpoints" / "seed-0" / "final" / "hac.safetensors"
    place.rename(place.with_name("table.pt"))
    entry = Entry.open(directory, tmp_path / "results")
    row = play_row(entry, Here(), SILENT, directory=Path(tmp_path, "play"))
    assert row.drop_p < SIGNIFICANCE
    played = entry.read()
    (official,), (later,) = (runs["table4"] for runs in (played.official, played.fresh))
    assert official["pushing"].success.value == 1
    assert later["pushing"].success.value <= 1 / 2
