"""Small runs, made the way the command line makes them."""

from pathlib import Path

from minitouch_bench.evaluation.engine import Contest
from minitouch_bench.evaluation.evaluation import Request, begin, evaluate
from minitouch_bench.evaluation.local_engine import LocalEngine
from minitouch_bench.evaluation.storage import lock_directory, write_actions
from minitouch_bench.evaluation.suites import find_suite
from minitouch_bench.policies.isolation.levels import Isolation
from minitouch_bench.policies.process import PolicyLimits
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.records import EvaluationRun

TASKS = ("pushing", "opening", "pick-up")


def request(
    policy="scripted",
    tasks=TASKS,
    episodes=2,
    seed=0,
    *,
    exploration=None,
    isolation=Isolation.SANDBOX,
    **limits,
):
    contest = Contest(
        parse_source(policy, trust=True),
        None if exploration is None else parse_source(exploration, trust=True),
        PolicyLimits(**limits),
        trust=True,
        isolation=isolation,
    )
    return Request(find_suite("table4"), tasks, episodes, seed, contest)


def run(
    wanted: Request, directory: Path, workers=1, *, engine=None, resume=False, fresh=False
) -> EvaluationRun:
    """Run into a directory; its journal and actions are there afterwards."""
    seen = []
    with lock_directory(directory):
        begun = begin(wanted, directory, resume=resume, fresh=fresh)
        engine = engine or LocalEngine(workers)
        done = evaluate(wanted, engine, begun, directory, seen.append, workers=workers)
        write_actions(done.records, directory)
    assert len(seen) == len(done.records) - len(begun.records)
    return done


def digests(done: EvaluationRun) -> list[tuple[str, str, str]]:
    return [(record.spec.key, record.outcome, record.trace.digest()) for record in done.records]
