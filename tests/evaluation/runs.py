"""Small runs, made the way the command line makes them."""

from pathlib import Path

from minitouch_bench.evaluation.actions import write_actions
from minitouch_bench.evaluation.actors import PolicySetup
from minitouch_bench.evaluation.local_engine import LocalEngine
from minitouch_bench.evaluation.run import RunRequest, open_run, run_episodes
from minitouch_bench.evaluation.suites import find_suite
from minitouch_bench.files import lock_directory
from minitouch_bench.policies.isolation.options import Isolation, IsolationOptions
from minitouch_bench.policies.limits import PolicyLimits
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
    setup = PolicySetup(
        parse_source(policy, trust=True),
        None if exploration is None else parse_source(exploration, trust=True),
        IsolationOptions(isolation, trust=True, limits=PolicyLimits(**limits)),
    )
    return RunRequest(find_suite("table4"), tasks, episodes, seed, setup)


def run(
    wanted: RunRequest, directory: Path, workers=1, *, engine=None, resume=False, fresh=False
) -> EvaluationRun:
    """Run into a directory; its journal and actions are there afterwards."""
    seen = []
    with lock_directory(directory):
        opened = open_run(wanted, directory, resume=resume, fresh=fresh)
        done = run_episodes(wanted, opened, engine or LocalEngine(workers), seen.append)
        write_actions(done.records, directory)
    assert len(seen) == len(done.records) - len(opened.records)
    return done


def digests(done: EvaluationRun) -> list[tuple[str, str, str]]:
    return [(record.spec.key, record.outcome, record.trace.digest()) for record in done.records]
