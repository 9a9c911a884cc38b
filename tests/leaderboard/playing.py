"""Rows played in earnest: one task and few episodes, in place of the official numbers."""

import gzip
import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from minitouch_bench.leaderboard import fresh, play
from minitouch_bench.policies.native import save_native
from minitouch_bench.policies.networks import TouchActor, VisualEncoder
from minitouch_bench.policies.policy import Isolation, IsolationOptions
from minitouch_bench.runs.plan import make_plan
from tests.evaluation.runs import play_here

EPISODES = 1
STEPS = 10
TASKS = ("pushing",)
RUNS = ("seed-0/table4", "seed-0/table4-fresh")


def play_few(patch, official=EPISODES, fresh_ones=EPISODES) -> None:
    """Let rows have few episodes."""

    def small_plan(suite):
        return replace(make_plan(suite), episodes=official, tasks=TASKS)

    for module in (play, fresh):
        patch.setattr(module, "make_plan", small_plan)
    patch.setattr(fresh, "FRESH_EPISODES", fresh_ones)


def play_quickly(patch) -> None:
    """Let rows have few short episodes, whose policies are loaded in this process."""
    play_few(patch)
    here = IsolationOptions(Isolation.NONE, trust=True)
    patch.setattr(play, "prepare_policies", partial(play.prepare_policies, isolation=here))
    play_here(patch, STEPS)


def write_policy(path: Path, seed: int = 0) -> Path:
    """Write a checkpoint that acts as its first weights say."""
    torch.manual_seed(seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_native(TouchActor(5, encoder=VisualEncoder(1 / 32)), path)
    return path


def digests(results: Path) -> dict[str, str]:
    """Return the digest of each finished run of a row."""
    found = {}
    for path in results.rglob("run.json.gz"):
        document = json.loads(gzip.decompress(path.read_bytes()))
        found[path.parent.relative_to(results).as_posix()] = document["digest"]
    return found
