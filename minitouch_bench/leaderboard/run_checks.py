"""A run of a submission held against the protocol, its suite, and its own files' claims."""

import hashlib
import re
from collections import Counter
from collections.abc import Sequence
from functools import cache

from minitouch_bench.evaluation.suites import SUITES, why_unofficial
from minitouch_bench.leaderboard.faults import Faults
from minitouch_bench.leaderboard.plausibility import contradictions
from minitouch_bench.leaderboard.submission import ALL_TASKS, CheckpointFile, TrainingSeed
from minitouch_bench.metrics.digest import run_digest
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.policies.loading import BUILT_IN, FORMATS
from minitouch_bench.policies.sources import DIRECTORY, NOTES
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import (
    EpisodeMetrics,
    EpisodeSpec,
    Outcome,
    PolicyIdentity,
    Role,
    RunHeader,
    SavedRun,
)

IDENTITY = ("seed", "shape", "family", "split")
"""What the suite fixes of an episode beside its task and index."""

SHA256 = re.compile(r"[0-9a-f]{64}")
KINDS = (*FORMATS, "scripted", DIRECTORY)
MAX_TEXT = 1000
MAX_NAMED = 50
"""Packages, or facts of the machine, that an honest run may name."""

NAMED = 3
"""Episodes named in one line; the rest are counted."""

RUN_AGAIN = "evaluate again with this version of minitouch-bench"
PACK_AGAIN = "pack the run as it was written"


def is_other_protocol(header: RunHeader) -> bool:
    """Tell whether a run was made under another protocol than this installation's."""
    return (header.protocol, header.protocol_digest) != (PROTOCOL.name, PROTOCOL.digest())


def check_run(saved: SavedRun, suite: str, seed: TrainingSeed, place: str, faults: Faults) -> None:
    """Check all that ``run.json`` says by itself.

    Of a run of another protocol nothing more can be said: its suite is unknown here.
    """
    if is_other_protocol(saved.header):
        faults.add(place, _other_protocol(saved.header), RUN_AGAIN, is_protocol=True)
        return
    _check_header(saved.header, suite, place, faults)
    _check_policy(saved.header.policy, seed.files(Role.FINAL), place, faults)
    if saved.header.exploration is not None:
        _check_policy(saved.header.exploration, seed.files(Role.EXPLORATION), place, faults)
    _check_texts(saved, place, faults)
    if saved.header.suite != suite:
        return
    for role, rows in _rows(saved):
        asked = [spec for spec in prescribed(suite) if spec.role is role]
        _check_episodes(rows, asked if _has_role(saved, role) else [], f"{place}, {role}", faults)
        _check_rows(rows, f"{place}, {role}", faults)
    _check_policy_faults(saved, place, faults)
    found = run_digest(saved.header.protocol_digest, saved.episodes, saved.exploration_episodes)
    if found != saved.digest:
        faults.add(place, "its digest is not that of its episodes", PACK_AGAIN)


@cache
def prescribed(suite: str) -> tuple[EpisodeSpec, ...]:
    """Return the episodes of both roles that an official run of a suite has."""
    return SUITES[suite].episodes(exploration=True)


def _rows(saved: SavedRun) -> tuple[tuple[Role, Sequence[EpisodeMetrics]], ...]:
    return (Role.FINAL, saved.episodes), (Role.EXPLORATION, saved.exploration_episodes)


def _has_role(saved: SavedRun, role: Role) -> bool:
    return role is Role.FINAL or saved.header.exploration is not None


def _other_protocol(header: RunHeader) -> str:
    return (
        f"its protocol is {header.protocol} {header.protocol_digest[:12]}, this installation's "
        f"{PROTOCOL} {PROTOCOL.digest()[:12]}"
    )


def _check_header(header: RunHeader, suite: str, place: str, faults: Faults) -> None:
    if header.suite != suite:
        faults.add(place, f"it is a run of the suite '{header.suite}', not {suite}", RUN_AGAIN)
        return
    reasons = why_unofficial(header, SUITES[suite])
    if reasons or not header.official or header.unofficial_because:
        said = "; ".join(reasons or header.unofficial_because) or "it says so"
        faults.add(place, f"it is unofficial: {said}", f"evaluate the whole suite {suite}")
    if header.isolation not in tuple(Isolation):
        faults.add(place, f"'{header.isolation}' is no level of isolation", PACK_AGAIN)
    elif header.isolation == Isolation.NONE and header.policy.kind != "scripted":
        faults.add(
            place,
            "the policy ran beside the simulator (isolation none), which it could read",
            "evaluate with --isolation sandbox",
        )


def _check_policy(
    policy: PolicyIdentity, files: Sequence[CheckpointFile], place: str, faults: Faults
) -> None:
    """Hold a policy against the checkpoint files that the submission names for it."""
    if policy.kind not in KINDS:
        faults.add(place, f"'{policy.kind}' is no kind of policy", PACK_AGAIN)
        return
    if policy.notes != NOTES.get(policy.kind, ()):
        faults.add(place, f"a {policy.kind} policy lacks its label, or has another's", PACK_AGAIN)
    if policy.digest != files_digest(policy.kind, files):
        faults.add(
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


def _check_texts(saved: SavedRun, place: str, faults: Faults) -> None:
    """Refuse texts beyond any honest length; all are escaped wherever they are shown."""
    header, environment = saved.header, saved.environment
    texts = [header.policy.name, header.policy.source, environment.started, *saved.faults.values()]
    if header.exploration is not None:
        texts += [header.exploration.name, header.exploration.source]
    for named in (environment.packages, environment.machine):
        texts += [*named.keys(), *named.values()]
        if len(named) > MAX_NAMED:
            faults.add(place, f"its environment names {len(named)} things", PACK_AGAIN)
    longest = max(map(len, texts))
    if longest > MAX_TEXT:
        faults.add(
            place, f"a text in it has {longest} characters; the limit is {MAX_TEXT}", PACK_AGAIN
        )


def _check_episodes(
    rows: Sequence[EpisodeMetrics], asked: Sequence[EpisodeSpec], place: str, faults: Faults
) -> None:
    """Hold the episodes against the suite: each once, none else, with its seed and shape."""
    found = Counter((row.task, row.index) for row in rows)
    wanted = {(spec.task, spec.index): spec for spec in asked}
    missing = [key for key in wanted if key not in found]
    if missing:
        faults.add(
            place,
            f"{len(missing)} of {len(wanted)} episodes are missing: {_named(missing)}",
            "evaluate the whole suite",
        )
    if twice := [key for key, count in found.items() if count > 1]:
        faults.add(place, f"{len(twice)} episodes are there twice: {_named(twice)}", PACK_AGAIN)
    if unknown := [key for key in found if key not in wanted]:
        faults.add(
            place, f"{len(unknown)} episodes are not of the suite: {_named(unknown)}", PACK_AGAIN
        )
    if not (missing or twice or unknown) and [(r.task, r.index) for r in rows] != list(wanted):
        faults.add(place, "its episodes are not in the suite's order", PACK_AGAIN)
    for name in IDENTITY:
        other = [
            key
            for row in rows
            if (key := (row.task, row.index)) in wanted
            and getattr(row, name) != getattr(wanted[key], name)
        ]
        if other:
            faults.add(
                place,
                f"{len(other)} episodes have another {name} than the suite: {_named(other)}",
                "evaluate the suite as it is",
            )


def _check_rows(rows: Sequence[EpisodeMetrics], place: str, faults: Faults) -> None:
    """Keep what no episode can be; the same kind of contradiction once."""
    bad = [(row, found) for row in rows if (found := next(contradictions(row), None))]
    for row, what in bad[:NAMED]:
        faults.add(f"{place}, {row.task}/{row.index}", what, PACK_AGAIN)
    if len(bad) > NAMED:
        faults.add(place, f"{len(bad)} episodes contradict themselves", PACK_AGAIN)
    if undigested := [(r.task, r.index) for r in rows if not SHA256.fullmatch(r.digest)]:
        faults.add(place, f"episodes have no digest: {_named(undigested)}", PACK_AGAIN)


def _check_policy_faults(saved: SavedRun, place: str, faults: Faults) -> None:
    """Hold the texts of policy faults against the episodes that ended in one."""
    failed = {
        EpisodeSpec(role, row.task, row.index, row.seed).key
        for role, rows in _rows(saved)
        for row in rows
        if row.outcome is Outcome.POLICY_FAULT
    }
    if failed != set(saved.faults):
        other = sorted(failed ^ set(saved.faults))
        faults.add(place, f"faults and outcomes differ in {', '.join(other[:NAMED])}", PACK_AGAIN)


def is_built_in(policy: PolicyIdentity) -> bool:
    """Tell whether a policy is one of the calibration policies."""
    return policy.kind in BUILT_IN


def _named(keys: Sequence[tuple[str, int]]) -> str:
    shown = ", ".join(f"{task}/{index}" for task, index in keys[:NAMED])
    more = len(keys) - NAMED
    return f"{shown} and {more} more" if more > 0 else shown
