"""The whole check of a submission, with an engine that has its episodes already."""

import contextlib
import sys

import numpy as np
import pytest

from minitouch_bench.commands.leaderboard import validate
from minitouch_bench.evaluation import engine as engines
from minitouch_bench.leaderboard.proof import ProofLevel
from minitouch_bench.metrics.summary import summarize
from minitouch_bench.runs.actions import parse_actions
from minitouch_bench.runs.run import parse_run
from minitouch_bench.verification import replay_check
from tests.leaderboard.synthetic import make_submission, official_run
from tests.reporting.synthetic import make_record


class Played:
    """Gives the official episodes as they are recorded, and fresh ones like them."""

    def __init__(self):
        self.records = {record.spec: record for record in official_run(kind="zero").records}
        self.fresh = 0

    def run(self, source, specs):
        for spec in specs:
            self.fresh += spec not in self.records
            rng = np.random.default_rng(spec.seed)
            yield self.records.get(spec) or make_record(rng, spec, 0.8)


@pytest.fixture
def engine(monkeypatch):
    played = Played()
    monkeypatch.setattr(engines, "open_engine", lambda *_: contextlib.nullcontext(played))
    monkeypatch.setattr(replay_check, "prepare_rerun", lambda *_: None)
    return played


def count_calls(monkeypatch, function):
    """Count the calls of a function, by whatever module of the package it is called."""
    calls = []

    def counted(*arguments, **options):
        calls.append(arguments)
        return function(*arguments, **options)

    for name, module in list(sys.modules.items()):
        if name.startswith("minitouch_bench") and vars(module).get(function.__name__) is function:
            monkeypatch.setattr(module, function.__name__, counted)
    return calls


def test_a_run_is_read_once_unpacked_once_and_estimated_once(tmp_path, engine, monkeypatch, capsys):
    submission = make_submission(tmp_path, "zero", kind="zero", level=ProofLevel.SELF_REPORTED)
    counted = [count_calls(monkeypatch, step) for step in (parse_run, parse_actions, summarize)]
    validate([submission], prove=True)
    assert capsys.readouterr().out == "zero: valid, verified\n"
    assert engine.fresh == 50 * 4
    assert [len(calls) for calls in counted] == [1, 1, 1]
