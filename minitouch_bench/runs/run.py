"""A finished run: its facts as ``run.json`` and ``actions.npz`` contain them, read once.

Everything people look at is a view of it, and every check works on it.
"""

import hashlib
import os
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from minitouch_bench import files
from minitouch_bench.episode import (
    IN_MEMORY,
    Episode,
    EpisodeSpec,
    PlayedEpisode,
    PolicyIdentity,
    Role,
    Sha256,
)
from minitouch_bench.errors import RunDirectoryError, UnreadableFileError, UsageError
from minitouch_bench.json_io import read_json, write_json
from minitouch_bench.machine import RunEnvironment
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.summary import (
    Summary,
    TaskResult,
    episodes_frame,
    measure,
    summarize,
    summary_html,
    table4_frame,
    with_curves,
)
from minitouch_bench.protocol.minitouch import PROTOCOL, TASK_NAMES
from minitouch_bench.runs.actions import Actions, parse_actions
from minitouch_bench.runs.plan import Plan, first_of
from minitouch_bench.text import printable

if TYPE_CHECKING:
    import pandas as pd

RUN_FORMAT: Final = "minitouch-run"
RUN_VERSION: Final = 4
"""Raised whenever a field of ``run.json`` is added or means something else."""

NAMED = 3
"""Episodes named in one line; the rest are counted."""


@dataclass(frozen=True)
class RunHeader:
    """Everything that fixes the numbers of a run, known before its first episode.

    ``task_digests``: the protocol's digest for each task; results of a task are comparable where
    its digests are equal.
    """

    protocol: str
    protocol_digest: str
    task_digests: Mapping[str, str]
    plan: Plan
    official: bool
    unofficial_because: tuple[str, ...]
    policy: PolicyIdentity
    exploration: PolicyIdentity | None
    isolation: str

    def specs(self) -> tuple[EpisodeSpec, ...]:
        """Return the episodes of the run, in order."""
        return self.plan.specs(exploration=self.exploration is not None)

    def policies(self) -> tuple[PolicyIdentity, ...]:
        """Return the final policy, and the exploration policy where there is one."""
        return (self.policy,) if self.exploration is None else (self.policy, self.exploration)

    def rules_differ(self, other: "RunHeader") -> tuple[str, ...]:
        """Return the tasks of both runs that were not played by the same rules."""
        return tuple(
            task
            for task in self.plan.tasks
            if task in other.plan.tasks
            and self.task_digests.get(task) != other.task_digests.get(task)
        )


def is_weakly_isolated(kinds: set[str], isolation: str) -> bool:
    """Tell whether policies of these kinds are isolated less than they can be: unofficial."""
    needed = {"process": kinds == {"remote"}, "none": kinds == {"scripted"}}
    return IN_MEMORY not in kinds and not needed.get(isolation, True)


def make_header(
    plan: Plan, policy: PolicyIdentity, exploration: PolicyIdentity | None, isolation: str
) -> RunHeader:
    """Return the header of a run of this plan, under this installation's protocol."""
    kinds = {identity.kind for identity in (policy, exploration) if identity is not None}
    reasons = plan.why_unofficial()
    if IN_MEMORY in kinds:
        reasons += ("policy in memory, beside the simulator",)
    elif is_weakly_isolated(kinds, isolation):
        reasons += (f"isolation: {isolation}",)
    return RunHeader(
        protocol=PROTOCOL.name,
        protocol_digest=PROTOCOL.digest(),
        task_digests=plan.rules(),
        plan=plan,
        official=not reasons,
        unofficial_because=reasons,
        policy=policy,
        exploration=exploration,
        isolation=isolation,
    )


# Apart from ``Run``, whose ``episodes`` are a frame for Python users: here they are rows.
@dataclass(frozen=True)
class RunDocument:
    """What ``run.json`` contains: everything a report is made from.

    ``digest`` covers every episode: runs with equal digests have the same bits. ``faults`` says
    what the policy did wrong, by episode, such as "pushing/17" or "exploration/pushing/17"; each is
    a failed episode. Episodes are in the suite's order. Equal runs give equal documents except for
    ``environment``, which alone contains times.
    """

    format: Literal["minitouch-run"]
    version: Literal[4]
    digest: Sha256
    header: RunHeader
    environment: RunEnvironment
    summary: Summary
    faults: Mapping[str, str]
    episodes: tuple[Episode, ...]
    exploration_episodes: tuple[Episode, ...]


@dataclass(frozen=True, repr=False)
class Run:
    """A finished run: its facts as ``run.json`` has them, and what Python users read of them.

    ``run["pushing"]`` contains the estimates of a task, ``run["pushing"].success`` one of them.
    ``rows`` and ``exploration_rows``: what was measured in each episode, in the suite's order.
    ``name`` is what the run is called, usually its directory's. ``directory``: None in memory only.
    ``content``: bytes of ``run.json``, if it was read from a file. ``kept_actions``: those of a run
    without a directory, by episode. Other fields: ``RunDocument``.
    """

    digest: str
    header: RunHeader
    environment: RunEnvironment
    summary: Summary
    faults: Mapping[str, str]
    rows: tuple[Episode, ...]
    exploration_rows: tuple[Episode, ...]
    name: str
    directory: Path | None = None
    content: bytes = b""
    kept_actions: Mapping[str, Actions] = field(default_factory=dict, compare=False)

    @property
    def plan(self) -> Plan:
        """What the run plays."""
        return self.header.plan

    @property
    def place(self) -> str:
        """What messages call the run: its directory, or its name where it has none."""
        return str(self.directory or self.name)

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks of the run."""
        return self.plan.tasks

    @property
    def episodes(self) -> "pd.DataFrame":
        """One row per episode: the columns of ``episodes.csv``, family, split, digest and start."""
        return episodes_frame(self.rows)

    @property
    def exploration_episodes(self) -> "pd.DataFrame":
        """The episodes of the exploration policy; no rows without one."""
        return episodes_frame(self.exploration_rows)

    def table4(self) -> "pd.DataFrame":
        """Return Table 4 in the paper's shape: metrics as rows, tasks as groups of columns.

        Each task has the columns ``value``, ``low`` and ``high`` (95 %), NaN without estimate.
        """
        return table4_frame(self.summary)

    def __getitem__(self, task: str) -> TaskResult:
        for summary in self.summary.tasks:
            if summary.task == task:
                return summary
        raise KeyError(f"the run has no task '{task}'; it has {', '.join(self.tasks)}")

    def __str__(self) -> str:
        reasons = f"unofficial: {'; '.join(self.header.unofficial_because)}"
        label = "official" if self.header.official else reasons
        title = f"{self.header.policy.name} on {self.plan.suite}, {label}"
        if self.faults:
            key, text = next(iter(self.faults.items()))
            title += f"; policy faults: {len(self.faults)}, the first in {key}: {text}"
        return "\n\n".join([printable(title), *(str(one) for one in self.summary.tasks)])

    def _repr_html_(self) -> str:
        return summary_html(str(self).partition("\n")[0], self.summary)

    def __repr__(self) -> str:
        label = "official" if self.header.official else "unofficial"
        faults = f", policy faults: {len(self.faults)}" if self.faults else ""
        what = f"{self.header.policy.name} on {self.plan.suite}, {label}{faults}"
        return f"<Run of {what}: {', '.join(self.tasks)}>"

    def by_role(self) -> tuple[tuple[Role, tuple[Episode, ...]], ...]:
        """Return the rows of each role, the final policy's first."""
        return (Role.FINAL, self.rows), (Role.EXPLORATION, self.exploration_rows)

    @cached_property
    def actions(self) -> Mapping[str, Actions]:
        """The recorded actions by episode, as in "pushing/17", float32 (T, A) each.

        Raises:
            RunDirectoryError: the file is missing or damaged, or contains other episodes.
        """
        if self.directory is None:
            return self.kept_actions
        path = self.directory / files.ACTIONS_FILE
        if (path.parent / files.PACKED_RUN_FILE).exists():
            words = ("minitouch-bench evaluate", self.header.policy.source, *self.plan.as_options())
            raise UnreadableFileError(
                f"{path.parent} is kept without its actions; the checkpoint gives them again: "
                f"{' '.join(words)}"
            )
        with files.os_errors_as(UnreadableFileError, path, "read"):
            content = files.read_file(path, files.LARGEST_ACTIONS)
        return parse_actions(content, self.header.specs(), str(path))

    def actions_of(self, key: str) -> Actions:
        """Return the recorded actions of the episode called ``key``.

        Raises:
            RunDirectoryError: they are missing, or the file is missing or damaged.
        """
        if key not in self.actions:
            raise RunDirectoryError(f"{self.place} has no actions of {key}")
        return self.actions[key]

    def specs_and_rows(self) -> Iterator[tuple[EpisodeSpec, Episode]]:
        """Walk through the episodes of the plan with the row of each."""
        return zip(self.header.specs(), (*self.rows, *self.exploration_rows), strict=True)

    def find(self, key: str) -> tuple[EpisodeSpec, Episode]:
        """Return the episode called ``key``, as ``pushing/17``.

        Raises:
            UsageError: there is none.
        """
        for spec, row in self.specs_and_rows():
            if spec.key == key:
                return spec, row
        by_task = {spec.key.rpartition("/")[0]: spec.key for spec in self.header.specs()}
        names = [f"{task}/0 to {last}" for task, last in by_task.items()]
        known = first_of(self.plan.chosen, NAMED) or ", ".join(names)
        raise UsageError(f"the run has no episode '{key}'; it has {known}")


def make_run(
    header: RunHeader,
    environment: RunEnvironment,
    records: Iterable[PlayedEpisode],
    name: str,
    directory: Path | None = None,
) -> Run:
    """Measure the episodes of a plan, given in its order, and estimate every metric, once."""
    records = tuple(records)
    rows = {
        role: tuple(measure(record) for record in records if record.spec.role is role)
        for role in Role
    }
    episodes, exploration = rows[Role.FINAL], rows[Role.EXPLORATION]
    estimates = summarize(header.plan.tasks, episodes, exploration, header.plan.seed)
    return Run(
        digest=run_digest(header, episodes, exploration),
        header=header,
        environment=environment,
        summary=with_curves(estimates, records),
        faults={record.spec.key: record.fault for record in records if record.fault},
        rows=episodes,
        exploration_rows=exploration,
        name=name,
        directory=directory,
        kept_actions={} if directory else {one.spec.key: one.trace.actions for one in records},
    )


def run_digest(
    header: RunHeader, episodes: Iterable[Episode], exploration_episodes: Iterable[Episode] = ()
) -> str:
    """Return the SHA-256 over the rules of each task and the episodes, in the run's order.

    Of an episode it covers the task, index, seed, shape, outcome and the trajectory's own
    digest, and so every metric but ``clipped_actions``. It does not cover the policy or
    the machine: the same bits give the same digest.
    """
    rules = (f"{task} {header.task_digests.get(task, '')}" for task in header.plan.tasks)
    sha = hashlib.sha256("\n".join(rules).encode())
    for role, listed in (("final", episodes), ("exploration", exploration_episodes)):
        for episode in listed:
            identity = (role, episode.task, episode.index, episode.seed, episode.shape)
            result = (episode.outcome.value, episode.digest)
            sha.update(("\n" + " ".join(map(str, (*identity, *result)))).encode())
    return sha.hexdigest()


def run_json(run: Run) -> bytes:
    """Write a run as the content of ``run.json``: all but what it is called.

    Raises:
        ValueError: it contains NaN or infinity.
    """
    document = RunDocument(
        RUN_FORMAT, RUN_VERSION, run.digest, run.header, run.environment, run.summary, run.faults,
        episodes=run.rows, exploration_episodes=run.exploration_rows,
    )  # fmt: skip
    return write_json(document)


@dataclass(frozen=True)
class _Mark:
    format: str
    version: int


def parse_run(content: bytes, name: str, directory: Path | None = None) -> Run:
    """Read a run from the content of its ``run.json``; ``name`` is what it is called.

    Raises:
        RunDirectoryError: it is not a run, or of another version.
    """
    mark = read_json(content, _Mark, files.RUN_FILE)
    if mark.format != RUN_FORMAT:
        raise RunDirectoryError(f"{files.RUN_FILE}: its format is not '{RUN_FORMAT}'")
    if mark.version != RUN_VERSION:
        what = f"has version {mark.version}, not {RUN_VERSION}; use the program that wrote it"
        raise RunDirectoryError(f"{files.RUN_FILE} {what}")
    document = read_json(content, RunDocument, files.RUN_FILE)
    summary = document.summary
    rows = (*document.episodes, *document.exploration_episodes)
    tasks = {row.task for part in (rows, summary.tasks, summary.generalization) for row in part}
    metrics = {name for task in summary.tasks for name in task.estimates}
    metrics |= {name for gap in summary.generalization for name in (gap.family_metric, *gap.gaps)}
    named = {"task": tasks | {*document.header.plan.tasks}, "metric": metrics}
    for what, known in (("task", TASK_NAMES), ("metric", METRICS)):
        if unknown := sorted(named[what].difference(known)):
            raise RunDirectoryError(f"{files.RUN_FILE}: this version has no {what} {unknown[0]!a}")
    return Run(
        document.digest, document.header, document.environment, summary, document.faults,
        document.episodes, document.exploration_episodes, name, directory, content,
    )  # fmt: skip


def read_run(directory: Path) -> Run:
    """Read a run from its directory, or from the path of its ``run.json`` or ``run.json.gz``.

    Raises:
        RunDirectoryError: in one line that says what is wrong.
    """
    names = (files.RUN_FILE, files.PACKED_RUN_FILE)
    file = directory if directory.name in names else directory / names[0]
    if not os.path.lexists(file):
        file = file.with_name(names[1])
    try:
        content = files.read_file(file)
        if file.name == files.PACKED_RUN_FILE:
            content = files.unpack(content)
    except zlib.error as error:
        raise RunDirectoryError(f"{file} is damaged: {error}") from error
    except (FileNotFoundError, NotADirectoryError) as error:
        if (file.parent / files.JOURNAL_FILE).exists():
            what = "contains an unfinished run: the command that began it finishes it with --resume"
        elif file.parent.exists():
            what = f"is not a run directory: it has no {files.RUN_FILE}"
            deeper = (f"*/{files.RUN_FILE}*", f"*/*/{files.RUN_FILE}*")
            if found := [path for pattern in deeper for path in file.parent.glob(pattern)]:
                what += f", but {min(found).parent.relative_to(file.parent)} in it is one"
        else:
            what = "is not a run directory: it does not exist"
        raise RunDirectoryError(f"{file.parent} {what}") from error
    except OSError as error:
        raise UnreadableFileError(f"{file} cannot be read: {error.strerror}") from error
    try:
        return parse_run(content, file.resolve().parent.name, file.parent)
    except RunDirectoryError as error:
        raise RunDirectoryError(f"{file.parent}: {error}") from error
