"""Worker processes that die: replaced, retried, and never left behind."""

import os

from minitouch_bench.evaluation.rollout import LocalEngine
from minitouch_bench.runs.plan import make_plan
from tests.evaluation.runs import request
from tests.process_tree import command_line, descendants


def workers():
    """Return the ids of the worker processes of this one."""
    every = descendants(os.getpid())
    return [pid for pid in every if b"minitouch_bench.processes" in command_line(pid)]


def test_breaking_off_ends_the_workers():
    wanted = request("zero")
    specs = make_plan("table4").specs()
    records = LocalEngine(2).run(wanted, specs[:10])
    next(records)
    records.close()
    assert not workers()
