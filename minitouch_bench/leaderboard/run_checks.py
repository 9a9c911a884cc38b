"""A run of a submission held against the protocol, its suite, and its own files' claims."""

import hashlib
from collections.abc import Iterator, Sequence

from minitouch_bench.leaderboard.submission import ALL_TASKS, CheckpointFile, TrainingSeed
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.policies.loading import FORMATS
from minitouch_bench.policies.sources import DIRECTORY, NOTES
from minitouch_bench.protocol.minitouch import GOAL_TASKS, PROTOCOL
from minitouch_bench.records import (
    EpisodeMetrics,
    EpisodeSpec,
    Outcome,
    PolicyIdentity,
    Role,
    RunHeader,
    SavedRun,
)
from minitouch_bench.reporting.run_directory import run_digest
from minitouch_bench.verification.problems import Problems
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

FINGERS = 2

MAX_TICKS = PROTOCOL.control.max_ticks


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
    _check_header(header, place, problems)
    _check_policy(header.policy, seed.files(Role.FINAL), place, problems)
    if header.exploration is not None:
        _check_policy(header.exploration, seed.files(Role.EXPLORATION), place, problems)
    _check_texts(saved, place, problems)
    for role, rows in saved.by_role():
        _check_rows(rows, f"{place}, {role}", problems)
    _check_policy_faults(saved, place, problems)
    if run_digest(header, saved.episodes, saved.exploration_episodes) != saved.digest:
        problems.add(place, "its digest is not that of its episodes", AS_WRITTEN)


def _check_header(header: RunHeader, place: str, problems: Problems) -> None:
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
    """Return the digest that a run records of these files, as ``policies.sources`` does."""
    if kind == DIRECTORY:
        sha = hashlib.sha256()
        for file in sorted(files, key=lambda file: file.file):
            sha.update(f"{file.file} {file.sha256}\n".encode())
        return sha.hexdigest()
    if len(files) == 1 and files[0].task == ALL_TASKS:
        return files[0].sha256
    return "several files" if files else ""


def _check_texts(saved: SavedRun, place: str, problems: Problems) -> None:
    """Refuse texts beyond any honest length; all are escaped wherever they are shown."""
    header, environment = saved.header, saved.environment
    texts = [header.policy.name, header.policy.source, environment.started, *saved.faults.values()]
    if header.exploration is not None:
        texts += [header.exploration.name, header.exploration.source]
    for named in (environment.packages, environment.machine):
        texts += [*named.keys(), *named.values()]
        if len(named) > MAX_NAMED:
            problems.add(place, f"its environment names {len(named)} things", AS_WRITTEN)
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
    failed = {
        EpisodeSpec(role, row.task, row.index, row.seed).key
        for role, rows in saved.by_role()
        for row in rows
        if row.outcome is Outcome.POLICY_FAULT
    }
    if failed != set(saved.faults):
        other = sorted(failed ^ set(saved.faults))
        problems.add(place, f"faults and outcomes differ in {', '.join(other[:NAMED])}", AS_WRITTEN)


def contradictions(row: EpisodeMetrics) -> Iterator[str]:
    """Yield what cannot be true of one episode, in words."""
    yield from _outcome(row)
    yield from _length(row)
    yield from _touch(row)


def _outcome(row: EpisodeMetrics) -> Iterator[str]:
    if row.outcome is Outcome.SUCCESS and row.task not in GOAL_TASKS:
        yield f"{row.task} has no goal and cannot succeed"
    if row.outcome is Outcome.LEFT_WORKSPACE and not PROTOCOL.task(row.task).object_can_leave:
        yield f"in {row.task} nothing can leave the workspace"
    reward = PROTOCOL.task(row.task).success_reward if row.success else 0.0
    if row.episode_return != reward:
        yield f"the return is {row.episode_return:g}, not {reward:g}"


def _length(row: EpisodeMetrics) -> Iterator[str]:
    longest = PROTOCOL.task(row.task).max_steps
    least = 0 if row.outcome is Outcome.POLICY_FAULT else 1
    if not least <= row.steps <= longest:
        yield f"{row.steps} steps, not {least} to {longest}"
    if row.outcome is Outcome.STEP_LIMIT and row.steps != longest:
        yield f"it ended at the step limit after {row.steps} of {longest} steps"
    if not row.steps <= row.ticks <= row.steps * MAX_TICKS:
        yield f"{row.ticks} ticks are not {row.steps} steps of 1 to {MAX_TICKS} ticks"
    if row.clipped_actions > row.steps:
        yield f"{row.clipped_actions} clipped actions in {row.steps} steps"


def _touch(row: EpisodeMetrics) -> Iterator[str]:
    if row.touch_interaction > row.ticks:
        yield f"{row.touch_interaction} ticks of contact in {row.ticks} ticks"
    if not row.touch_steps <= min(row.steps, row.touch_interaction):
        yield f"{row.touch_steps} steps with contact, {row.touch_interaction} ticks of contact"
    if row.touch_onsets > FINGERS * row.touch_interaction:
        yield f"{row.touch_onsets} contacts begun in {row.touch_interaction} ticks of contact"
    touched = row.touch_interaction > 0
    if touched != (row.touch_steps > 0) or touched != (row.touch_onsets > 0):
        yield "some of its figures of contact are 0 and others are not"
    if touched != (row.first_touch_tick is not None):
        yield f"first touch is {row.first_touch_tick}, contact {row.touch_interaction} ticks"
    elif row.first_touch_tick is not None and row.first_touch_tick >= row.ticks:
        yield f"first touch at tick {row.first_touch_tick} of {row.ticks}"
    if row.touch_variance < 0 or row.object_movement < 0:
        yield "a variance is below 0"
