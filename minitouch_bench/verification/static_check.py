"""A run checked by itself: its plan, its episodes, and what follows from them.

No episode is played. What ``run.json`` says is computed again from its episodes and compared.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice, zip_longest
from operator import attrgetter
from typing import Any

from minitouch_bench import errors
from minitouch_bench.episode import IN_MEMORY, Outcome, episode_key
from minitouch_bench.files import RUN_FILE
from minitouch_bench.json_io import plain
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.summary import summarize
from minitouch_bench.policies.policy import Isolation
from minitouch_bench.protocol.minitouch import SUITE_NAMES
from minitouch_bench.runs.run import NAMED, Run, RunHeader, make_header, run_digest, run_json
from minitouch_bench.text import plain_line

SHOWN_CHARACTERS = 400
"""Characters of one part of a problem; a stranger's text never fills the screen."""
VALUE_CHARACTERS = 60
"""Characters of a value in a difference."""

NEARLY_ZERO = 1e-12
"""Two smaller estimates are equal: a difference of means leaves such a rest."""
ROUNDING = 1e-9
"""Relative difference of an estimate that another processor's arithmetic explains."""

IDENTITY = attrgetter("task", "index", "seed", "shape", "family", "split")
"""What the suite fixes of an episode."""
RUN_AGAIN = "evaluate again with this version of minitouch-bench"
AS_WRITTEN = "take the run as it was written"


@dataclass(frozen=True)
class Problem:
    """One problem: the file or key, what is wrong there, and what to do about it.

    ``is_other_protocol``: the run is of another protocol, which is not a mistake of its maker.
    """

    place: str
    what: str
    remedy: str = ""
    is_other_protocol: bool = False

    def __str__(self) -> str:
        parts = (self.what, self.remedy) if self.remedy else (self.what,)
        text = "; ".join(plain_line(part, SHOWN_CHARACTERS) for part in parts)
        return f"{plain_line(self.place, SHOWN_CHARACTERS)}: {text}"


def check_run(run: Run) -> tuple[Problem, ...]:
    """Return every problem of a run, of its episodes and of what is said of them.

    What follows from its episodes is looked at where they are those of its plan and unedited.
    """
    return check_episodes(run) or tuple(_estimates(run))


def check_episodes(run: Run) -> tuple[Problem, ...]:
    """Return every problem of a run's header and episodes; no estimate is computed."""
    return check_plan(run) or (*_faults(run), *_digest(run))


def check_plan(run: Run) -> tuple[Problem, ...]:
    """Return the problems for which a run's episodes cannot be known or are not the plan's."""
    return tuple(_protocol(run.header)) or tuple(_settings(run.header)) or tuple(_episodes(run))


def compare_values(path: str, recorded: Any, computed: Any) -> Iterator[Problem]:
    """Yield each place where two JSON values differ; estimates may differ by ROUNDING."""
    if isinstance(recorded, Mapping) and isinstance(computed, Mapping):
        for key in dict.fromkeys([*recorded, *computed]):
            inner = f"{path}.{key}" if path else str(key)
            if key not in recorded or key not in computed:
                yield Problem(inner, "missing" if key in computed else "should not be there")
            else:
                yield from compare_values(inner, recorded[key], computed[key])
    elif isinstance(recorded, list | tuple) and isinstance(computed, list | tuple):
        if len(recorded) != len(computed):
            yield Problem(path, f"{len(recorded)} entries recorded, {len(computed)} found")
        else:
            for index, pair in enumerate(zip(recorded, computed, strict=True)):
                yield from compare_values(f"{path}[{index}]", *pair)
    elif not _equal(recorded, computed):
        then, now = (plain_line(repr(value), VALUE_CHARACTERS) for value in (recorded, computed))
        yield Problem(path, f"{then} recorded, {now} found")


def _equal(recorded: Any, computed: Any) -> bool:
    if isinstance(recorded, float) and isinstance(computed, float):
        return math.isclose(recorded, computed, rel_tol=ROUNDING, abs_tol=NEARLY_ZERO)
    return bool(recorded == computed)


def _protocol(header: RunHeader) -> Iterator[Problem]:
    """Compare the digest of each task with this installation's."""
    plan = header.plan
    if plan.suite not in SUITE_NAMES:
        return  # which _settings says
    rules = plan.rules()
    other = [task for task, digest in rules.items() if header.task_digests.get(task) != digest]
    if other:
        recorded, here = header.task_digests.get(other[0], ""), rules[other[0]]
        yield Problem(
            "protocol",
            f"the rules of {', '.join(other)} are not this installation's ({other[0]}: "
            f"{recorded[:12] or 'none'} recorded, {here[:12]} here)",
            RUN_AGAIN,
            is_other_protocol=True,
        )


def _settings(header: RunHeader) -> Iterator[Problem]:
    """Compare what the header says of the run with the suite that it names."""
    if mistake := header.plan.mistake():
        yield Problem("header.plan", mistake, RUN_AGAIN)
        return
    expected = replace(
        make_header(header.plan, header.policy, header.exploration, header.isolation),
        protocol_digest=header.protocol_digest,  # a later version may have more suites
    )
    for difference in compare_values("header", plain(header), plain(expected)):
        yield replace(difference, remedy=AS_WRITTEN)
    if what := _isolation_mistake(header):
        yield Problem("header.isolation", what, AS_WRITTEN)


def _isolation_mistake(header: RunHeader) -> str:
    """Return why no policies of these kinds ran at the recorded level of isolation, or ""."""
    if header.isolation not in tuple(Isolation):
        return "there is no such level of isolation"
    kinds = {policy.kind for policy in header.policies()}
    if kinds & {"scripted", IN_MEMORY} and header.isolation != Isolation.NONE:
        return f"it is {header.isolation}; a scripted policy and one in memory have none"
    if kinds == {"remote"} and header.isolation == Isolation.SANDBOX:
        return "it is sandbox; a policy server's client needs the network"
    return ""


def _episodes(run: Run) -> Iterator[Problem]:
    """Compare the rows of both roles with the episodes of the plan, in their order."""
    specs = run.header.specs()
    for role, rows in run.by_role():
        planned = [spec for spec in specs if spec.role is role]
        pairs = zip_longest(map(IDENTITY, planned), map(IDENTITY, rows))
        if other := next((spec or row for spec, row in pairs if spec != row), None):
            what = "from here the episodes are not the suite's, in its order, seeds and shapes"
            counts = f"{len(rows)} recorded of {len(planned)}"
            yield Problem(episode_key(role, *other[:2]), f"{what} ({counts})", RUN_AGAIN)


def _faults(run: Run) -> Iterator[Problem]:
    """Compare the texts of policy faults with the episodes that ended in one."""
    failed = {spec.key for spec, row in run.specs_and_rows() if row.outcome is Outcome.POLICY_FAULT}
    if failed != set(run.faults):
        other = sorted(failed ^ set(run.faults))
        what = f"faults and outcomes differ in {', '.join(other[:NAMED])}"
        yield Problem("faults", what, AS_WRITTEN)


def _digest(run: Run) -> Iterator[Problem]:
    if run.digest != run_digest(run.header, run.rows, run.exploration_rows):
        yield Problem("digest", "it is not that of the episodes", AS_WRITTEN)
    if run.content and run.content != run_json(run):
        what = "it was edited or formatted again, or a key in it is unknown or there twice"
        yield Problem(RUN_FILE, what, AS_WRITTEN)


def _estimates(run: Run) -> Iterator[Problem]:
    """Compute every estimate from the episodes, with the run's own random stream."""
    plan = run.plan
    expected = summarize(plan.tasks, run.rows, run.exploration_rows, plan.seed)
    bare = [
        replace(task, touch_curve=(), force_curve=(), curve_episodes=())
        for task in run.summary.tasks
    ]
    recorded = replace(run.summary, tasks=tuple(bare))
    differences = compare_values("summary", plain(recorded), plain(expected))
    later = tuple(f".{metric.name}" for metric in METRICS.values() if metric.added_later)
    wrong = (
        one for one in differences if not (one.what == "missing" and one.place.endswith(later))
    )
    for difference in islice(wrong, 2 * NAMED):  # one edited figure shows in several places
        yield replace(difference, remedy=AS_WRITTEN)


def refuse_edited(run: Run) -> Run:
    """Refuse a stored run that cannot have been written as it is, as far as ``run.json`` says so.

    Its digest does not cover every number of an episode, so the estimates are computed again. Only
    ``replay_run`` finds numbers that were changed in every place where they are written. How
    ``run.json`` is formatted does not matter: a repository's hooks may format it.

    Raises:
        RunDirectoryError: it was edited.
        UsageError: it was played by other rules than this installation's.
    """
    for problem in check_run(replace(run, content=b"")):
        if problem.is_other_protocol:
            raise errors.UsageError(f"{run.directory}: {problem.what}: make the run again")
        raise errors.RunDirectoryError(f"{run.directory} was edited or damaged.\n{problem}")
    return run


def refuse_unplayable(run: Run) -> None:
    """Refuse a run whose episodes cannot be played here.

    Raises:
        UsageError: its protocol, its plan or its episodes are not this installation's.
    """
    for problem in check_plan(run):
        raise errors.UsageError(f"{run.directory or run.name} cannot be replayed.\n{problem}")
