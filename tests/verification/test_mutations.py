"""Nothing that is spoiled makes a reader hang, fail, take memory, or touch a user's file."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def problems(kind: str, seed: int, count: int) -> list[str]:
    command = [sys.executable, "-W", "ignore", "-m", "tests.verification.mutations"]
    options = [kind, str(seed), str(count)]
    done = subprocess.run(
        [*command, *options], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True
    )
    return json.loads(done.stdout)


@pytest.mark.parametrize(("kind", "count"), [("run", 50), ("submission", 10)])
def test_some_mutations_are_read_or_refused(kind, count):
    assert problems(kind, 0, count) == []


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("seed", range(10_000, 12_000, 250))
def test_many_mutations_are_read_or_refused(seed):
    for kind, count in (("run", 200), ("submission", 50)):
        assert problems(kind, seed, count) == []
