"""Worker processes that die: replaced, retried, and never left behind."""

import os
import signal

from minitouch_bench.evaluation.execution import header_of
from minitouch_bench.evaluation.rollout import LocalEngine
from minitouch_bench.runs.plan import make_plan
from tests.evaluation.runs import digests, request
from tests.process_tree import command_line, descendants


def workers():
    """Return the ids of the worker processes of this one."""
    every = descendants(os.getpid())
    return [pid for pid in every if b"minitouch_bench.processes" in command_line(pid)]


def test_a_worker_killed_from_outside_is_replaced_and_its_episode_repeated(finished):
    wanted = request()
    specs = header_of(wanted).specs()
    records = {}
    for record in LocalEngine(1).run(wanted, specs):
        if not records:
            for pid in workers():
                os.kill(pid, signal.SIGKILL)
        records[record.spec.key] = (record.spec.key, record.outcome, record.trace.digest())
    assert [records[spec.key] for spec in specs] == digests(finished[0])


def test_breaking_off_ends_the_workers():
    wanted = request("zero")
    specs = make_plan("table4").specs()
    records = LocalEngine(2).run(wanted, specs[:10])
    next(records)
    records.close()
    assert not workers()
