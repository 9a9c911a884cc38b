"""A run of a submission held against the protocol, its suite, and what its files say.

What follows from the episodes (estimates, tables, actions) is computed again and compared.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.documents import plain
from minitouch_bench.evaluation.actions import read_actions
from minitouch_bench.files import ACTIONS_FILE
from minitouch_bench.leaderboard.inventory import RUN_LIMITS, read_plain
from minitouch_bench.leaderboard.submission import ALL_TASKS, CheckpointFile, TrainingSeed
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.summary import summarize_episodes
from minitouch_bench.policies.formats import FORMATS
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.policies.sources import DIRECTORY, NOTES, directory_digest
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import (
    EpisodeMetrics,
    EpisodeSpec,
    Outcome,
    PolicyIdentity,
    Role,
    RunHeader,
    SavedRun,
    TaskSummary,
)
from minitouch_bench.reporting.run_directory import derived_files, run_digest
from minitouch_bench.verification.problems import ROUNDING, Problems, compare_values
from minitouch_bench.verification.recorded_run import (
    AS_WRITTEN,
    NAMED,
    RUN_AGAIN,
    check_against_suite,
)

KINDS = (*FORMATS, "scripted", DIRECTORY)
MAX_TEXT = 1000
MAX_NAMED = 50
"""Packages, or facts of the machine, that an honest run may name."""

CURVE_TOLERANCE = 1e-6
"""Relative rounding of a sum over a touch curve's means."""


def check_run(
    saved: SavedRun, suite: str, seed: TrainingSeed, place: str, problems: Problems
) -> None:
    """Check all that ``run.json`` says by itself.

    Of a run of another suite, or of other settings or rules, nothing more can be said.
    """
    header = saved.header
    if header.suite != suite:
        problems.add(place, f"it is a run of the suite '{header.suite}', not {suite}", RUN_AGAIN)
        return
    if not header.official:
        said = "; ".join(header.unofficial_because)
        problems.add(place, f"it is unofficial: {said}", f"evaluate the whole suite {suite}")
        return
    for problem in check_against_suite(saved):
        problems.add_below(place, problem)
        if problem.is_other_protocol:
            return
    check_policies(header, seed, place, problems)
    _check_texts(saved, place, problems)
    for role, rows in saved.by_role():
        _check_rows(rows, f"{place}, {role}", problems)
    _check_policy_faults(saved, place, problems)
    if run_digest(header, saved.episodes, saved.exploration_episodes) != saved.digest:
        problems.add(place, "its digest is not that of its episodes", AS_WRITTEN)


def check_policies(header: RunHeader, seed: TrainingSeed, place: str, problems: Problems) -> None:
    """Check the policies that a run's header names: all that is known before its episodes."""
    _check_policy(header.policy, seed.files(Role.FINAL), place, problems)
    if header.exploration is not None:
        _check_policy(header.exploration, seed.files(Role.EXPLORATION), place, problems)
        if header.exploration.kind == "scripted" != header.policy.kind:
            problems.add(place, "its exploration is the scripted policy's, which reads the state")
    for policy in (header.policy, header.exploration):
        if policy is not None:
            _check_lengths((policy.name, policy.source), place, problems)
    if header.isolation not in tuple(Isolation):
        problems.add(place, f"'{header.isolation}' is no level of isolation", AS_WRITTEN)
    elif header.isolation == Isolation.NONE and header.policy.kind != "scripted":
        problems.add(
            place,
            "the policy ran beside the simulator (isolation none), which it could read",
            "evaluate with --isolation sandbox",
        )


def _check_policy(
    policy: PolicyIdentity, files: Sequence[CheckpointFile], place: str, problems: Problems
) -> None:
    """Hold a policy against the checkpoint files that the submission names for it."""
    if policy.kind not in KINDS:
        problems.add(place, f"'{policy.kind}' is no kind of policy", AS_WRITTEN)
        return
    if policy.notes != NOTES.get(policy.kind, ()):
        problems.add(place, f"a {policy.kind} policy lacks its label, or has another's", AS_WRITTEN)
    if policy.digest != files_digest(policy.kind, files):
        problems.add(
            place,
            f"the policy '{policy.name}' is not the checkpoints of submission.toml: "
            "their SHA-256 differ",
            "name the files that were evaluated, with their SHA-256",
        )


def files_digest(kind: str, files: Sequence[CheckpointFile]) -> str:
    """Return the digest that a run records of these files."""
    if kind == DIRECTORY:
        return directory_digest((file.file, file.sha256) for file in files)
    if len(files) == 1 and files[0].task == ALL_TASKS:
        return files[0].sha256
    return "several files" if files else ""


def _check_texts(saved: SavedRun, place: str, problems: Problems) -> None:
    """Refuse texts beyond any honest length; all are escaped wherever they are shown."""
    environment = saved.environment
    texts = [environment.started, *saved.faults.values()]
    for named in (environment.packages, environment.machine):
        texts += [*named.keys(), *named.values()]
        if len(named) > MAX_NAMED:
            problems.add(place, f"its environment names {len(named)} things", AS_WRITTEN)
    _check_lengths(texts, place, problems)


def _check_lengths(texts: Sequence[str], place: str, problems: Problems) -> None:
    longest = max(map(len, texts))
    if longest > MAX_TEXT:
        problems.add(
            place, f"a text in it has {longest} characters; the limit is {MAX_TEXT}", AS_WRITTEN
        )


def _check_rows(rows: Sequence[EpisodeMetrics], place: str, problems: Problems) -> None:
    """Keep what no episode can be; the same kind of contradiction once."""
    bad = [(row, found) for row in rows if (found := next(contradictions(row), None))]
    for row, what in bad[:NAMED]:
        problems.add(f"{place}, {row.task}/{row.index}", what, AS_WRITTEN)
    if len(bad) > NAMED:
        problems.add(place, f"{len(bad)} episodes contradict themselves", AS_WRITTEN)


def _check_policy_faults(saved: SavedRun, place: str, problems: Problems) -> None:
    """Hold the texts of policy faults against the episodes that ended in one."""
    failed = {spec.key for spec, row in _rows_by_spec(saved) if row.outcome is Outcome.POLICY_FAULT}
    if failed != set(saved.faults):
        other = sorted(failed ^ set(saved.faults))
        problems.add(place, f"faults and outcomes differ in {', '.join(other[:NAMED])}", AS_WRITTEN)


def contradictions(row: EpisodeMetrics) -> Iterator[str]:
    """Yield what cannot be true of one episode, in words."""
    task = PROTOCOL.task(row.task)
    if row.outcome is Outcome.SUCCESS and not task.has_goal:
        yield f"{row.task} has no goal and cannot succeed"
    if row.outcome is Outcome.LEFT_WORKSPACE and not task.object_can_leave:
        yield f"in {row.task} nothing can leave the workspace"
    if row.outcome is Outcome.STEP_LIMIT and row.steps != task.max_steps:
        yield f"it ended at the step limit after {row.steps} of {task.max_steps} steps"
    for metric in METRICS.values():
        if what := metric.contradiction(row):
            yield what


def check_estimates(saved: SavedRun, place: str, problems: Problems) -> None:
    """Compute every estimate from the episodes, with the run's own random stream."""
    rng = np.random.default_rng(saved.header.seed)
    found = summarize_episodes(saved.header.tasks, saved.episodes, saved.exploration_episodes, rng)
    without_curves = tuple(
        replace(task, touch_curve=(), touch_curve_episodes=()) for task in saved.summary.tasks
    )
    recorded = replace(saved.summary, tasks=without_curves)
    differences = compare_values("summary", plain(recorded), plain(found), ROUNDING)
    # A few of them: one edited figure shows in several places.
    for difference in islice(differences, 2 * NAMED):
        problems.add_below(place, replace(difference, remedy=AS_WRITTEN))
    for task in saved.summary.tasks:
        if what := _curve_at_fault(task, [e for e in saved.episodes if e.task == task.task]):
            problems.add(f"{place}, touch curve of {task.task}", what, AS_WRITTEN)


def check_tables(directory: Path, place: str, saved: SavedRun, problems: Problems) -> None:
    """Hold the CSV files and ``report.md`` against those that ``run.json`` gives, byte for byte."""
    expected = derived_files(saved, directory / place)
    for name, text in expected.items():
        if not (directory / place / name).exists():
            problems.add(f"{place}/{name}", "it is missing", AS_WRITTEN)
            continue
        with problems.caught(f"{place}/{name}"):
            if read_plain(directory, f"{place}/{name}", RUN_LIMITS[name]) != text.encode():
                problems.add(f"{place}/{name}", "it is not what run.json gives", AS_WRITTEN)
    for name in RUN_LIMITS:
        extra = name.endswith((".csv", ".md")) and name not in expected
        if extra and (directory / place / name).exists():
            problems.add(f"{place}/{name}", "run.json gives no such file", "remove it")


def check_actions(directory: Path, place: str, saved: SavedRun, problems: Problems) -> None:
    """Check that every episode has its actions, as many as it has steps, within -1 to 1."""
    rows = dict(_rows_by_spec(saved))
    with problems.caught(f"{place}/{ACTIONS_FILE}", AS_WRITTEN):
        actions = read_actions(directory / place, list(rows))
        missing = [spec.key for spec in rows if spec.key not in actions]
        if missing:
            problems.add(
                f"{place}/{ACTIONS_FILE}",
                f"the actions of {len(missing)} episodes are missing: {', '.join(missing[:NAMED])}",
                AS_WRITTEN,
            )
        for spec, row in rows.items():
            if spec.key in actions and (what := _actions_at_fault(actions[spec.key], row)):
                problems.add(f"{place}/{ACTIONS_FILE}, {spec.key}", what, AS_WRITTEN)


def _rows_by_spec(saved: SavedRun) -> Iterator[tuple[EpisodeSpec, EpisodeMetrics]]:
    """Walk through the rows of both roles with what they are called in ``actions.npz``."""
    for role, rows in saved.by_role():
        for row in rows:
            yield EpisodeSpec(role, row.task, row.index, row.seed), row


def _actions_at_fault(actions: NDArray[np.float32], row: EpisodeMetrics) -> str:
    """Return what is wrong with an episode's actions, "" if nothing."""
    if len(actions) != row.steps:
        return f"{len(actions)} actions, the episode has {row.steps} steps"
    # The recorded actions are as applied: a clipped one stands at a bound.
    at_bounds = int((np.abs(actions) == 1).any(axis=1).sum())
    if row.clipped_actions > at_bounds:
        return f"{row.clipped_actions} are said to be clipped, {at_bounds} are at a bound"
    return ""


def _curve_at_fault(task: TaskSummary, episodes: list[EpisodeMetrics]) -> str:
    """Return what is wrong with a touch curve, as far as rows can tell, "" if nothing."""
    steps = np.array([episode.steps for episode in episodes], np.int64)
    longest = int(steps.max(initial=0))
    reached = [int((steps > step).sum()) for step in range(longest)]
    if list(task.touch_curve_episodes) != reached or len(task.touch_curve) != longest:
        return "it is not over the episodes that reached each step"
    total = float(np.dot(task.touch_curve, reached)) if reached else 0.0
    expected = sum(episode.touch_interaction for episode in episodes)
    if abs(total - expected) > CURVE_TOLERANCE * max(1, expected):
        return f"it adds up to {total:.0f} ticks, the episodes to {expected}"
    return ""
