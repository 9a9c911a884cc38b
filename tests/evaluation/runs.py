"""Small runs, made the way the command line makes them."""

from contextlib import closing, nullcontext
from functools import partial
from pathlib import Path

from minitouch_bench import api
from minitouch_bench.evaluation import rollout
from minitouch_bench.evaluation.engine import Callbacks, LocalEngine
from minitouch_bench.evaluation.execution import header_of, open_run, play_missing
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.files import lock_directory
from minitouch_bench.policies.policy import Isolation, IsolationOptions
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.limits import PolicyLimits
from minitouch_bench.runs.plan import Plan
from minitouch_bench.runs.run import Run

TASKS = ("pushing", "opening", "pick-up")


class Here:
    """An engine without workers, which is quicker for a few episodes."""

    workers = 1

    def run(self, source, specs):
        with closing(EpisodeRunner(source)) as runner:
            yield from map(runner.run, specs)


def play_here(patch, steps: int) -> None:
    """Let ``evaluate`` play in this process, in episodes of at most so many control steps."""
    patch.setattr(api, "open_engine", lambda *_: nullcontext(Here()))
    patch.setattr(rollout, "MiniTouchEnv", partial(rollout.MiniTouchEnv, max_episode_steps=steps))


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
    plan = Plan("table4", tasks, episodes, seed, limits=PolicyLimits(**limits))
    return PolicySetup(
        plan,
        parse_source(policy),
        None if exploration is None else parse_source(exploration),
        IsolationOptions(isolation, trust=True, limits=plan.limits),
    )


def run(
    wanted: PolicySetup, directory: Path, workers=1, *, engine=None, resume=False, fresh=False
) -> Run:
    """Play in a directory; its actions, and what is done of the run, are there afterwards."""
    seen = []
    with lock_directory(directory):
        opened = open_run(header_of(wanted), directory, resume=resume, fresh=fresh)
        missing = len(opened.header.specs()) - len(opened.records)
        done = play_missing(
            wanted, opened, engine or LocalEngine(workers), Callbacks(episode=seen.append)
        )
    assert len(seen) == missing
    return done


def digests(done: Run) -> list[tuple[str, str, str]]:
    return [(spec.key, row.outcome, row.digest) for spec, row in done.specs_and_rows()]
