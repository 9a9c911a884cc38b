"""A run of a submission compared with what the submission says of it."""

from collections.abc import Sequence

from minitouch_bench.leaderboard.submission import ALL_TASKS, CheckpointFile, TrainingSeed
from minitouch_bench.policies.isolation.options import Isolation
from minitouch_bench.policies.loaders import FORMATS
from minitouch_bench.policies.sources import DIRECTORY, NOTES, directory_digest
from minitouch_bench.records import PolicyIdentity, Role
from minitouch_bench.runs.run import Run, RunHeader
from minitouch_bench.verification.problems import Problems
from minitouch_bench.verification.static_check import AS_WRITTEN, RUN_AGAIN, check_run

KINDS = (*FORMATS, "scripted", DIRECTORY)
MAX_TEXT = 1000
MAX_NAMED = 50
"""Packages, or facts of the machine, that an honest run may name."""


def check_submitted(
    run: Run, suite: str, seed: TrainingSeed, path: str, problems: Problems, *, recompute: bool
) -> None:
    """Check a run by itself, and against what the submission says of it.

    Of a run of another suite, or that is not official, nothing more can be said. ``recompute``:
    see ``check_run``.
    """
    header = run.header
    if header.plan.suite != suite:
        what = f"it is a run of the suite '{header.plan.suite}', not {suite}"
        problems.add(path, what, RUN_AGAIN)
        return
    if not header.official:
        reasons = "; ".join(header.unofficial_because)
        problems.add(path, f"it is unofficial: {reasons}", f"evaluate the whole suite {suite}")
        return
    _check_texts(run, path, problems)
    with problems.caught(path, AS_WRITTEN):
        for problem in check_run(run, recompute=recompute):
            problems.add_below(path, problem)
            if problem.is_other_protocol:
                return
    check_policies(header, seed, path, problems)


def check_policies(header: RunHeader, seed: TrainingSeed, path: str, problems: Problems) -> None:
    """Check the policies that a run's header names: all that is known before its episodes."""
    _check_policy(header.policy, seed.files(Role.FINAL), path, problems)
    if header.exploration is not None:
        _check_policy(header.exploration, seed.files(Role.EXPLORATION), path, problems)
        if header.exploration.kind == "scripted" != header.policy.kind:
            problems.add(path, "its exploration is the scripted policy's, which reads the state")
    for policy in header.policies():
        _check_lengths((policy.name, policy.source), path, problems)
    if header.isolation == Isolation.NONE and header.policy.kind != "scripted":
        problems.add(
            path,
            "the policy ran beside the simulator (isolation none), which it could read",
            "evaluate with --isolation sandbox",
        )


def _check_policy(
    policy: PolicyIdentity, files: Sequence[CheckpointFile], path: str, problems: Problems
) -> None:
    """Hold a policy against the checkpoint files that the submission names for it."""
    if policy.kind not in KINDS:
        problems.add(path, f"'{policy.kind}' is no kind of policy", AS_WRITTEN)
        return
    if policy.notes != NOTES.get(policy.kind, ()):
        problems.add(path, f"a {policy.kind} policy lacks its label, or has another's", AS_WRITTEN)
    if policy.digest != files_digest(policy.kind, files):
        problems.add(
            path,
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


def _check_texts(run: Run, path: str, problems: Problems) -> None:
    """Refuse texts beyond any honest length; all are escaped wherever they are shown."""
    environment = run.environment
    texts = [run.header.protocol_digest, environment.started, *run.faults.values()]
    for named in (environment.packages, environment.machine):
        texts += [*named.keys(), *named.values()]
        if len(named) > MAX_NAMED:
            problems.add(path, f"its environment names {len(named)} things", AS_WRITTEN)
    _check_lengths(texts, path, problems)


def _check_lengths(texts: Sequence[str], path: str, problems: Problems) -> None:
    longest = max(map(len, texts))
    if longest > MAX_TEXT:
        problems.add(
            path, f"a text in it has {longest} characters; the limit is {MAX_TEXT}", AS_WRITTEN
        )
