"""Worker processes that die: replaced, retried, and never left behind."""

import os

from minitouch_bench.evaluation.rollout import LocalEngine
from minitouch_bench.runs.plan import make_plan
from tests.evaluation.runs import request
from tests.process_tree import command_line, descendants


def test_breaking_off_ends_the_workers():
    records = LocalEngine(2).run(request("zero"), make_plan("table4").specs()[:10])
    next(records)
    records.close()
    below = map(command_line, descendants(os.getpid()))
    assert not any(b"minitouch_bench.processes" in line for line in below)
