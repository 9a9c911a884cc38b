"""Nothing that is spoiled makes a reader hang, fail, take memory, or touch a user's file."""

import json

import pytest

from tests.altered import ROOT
from tests.process_tree import run_python


def problems(kind: str, seed: int, count: int) -> list[str]:
    command = ("-W", "ignore", "-m", "tests.verification.mutations")
    return json.loads(run_python(*command, kind, seed, count, cwd=ROOT).stdout)


@pytest.mark.parametrize(("kind", "count"), [("run", 50), ("submission", 10)])
def test_some_mutations_are_read_or_refused(kind, count):
    assert problems(kind, 0, count) == []


@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("seed", range(10_000, 12_000, 250))
def test_many_mutations_are_read_or_refused(seed):
    for kind, count in (("run", 200), ("submission", 50)):
        assert problems(kind, seed, count) == []
