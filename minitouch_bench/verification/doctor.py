"""Checks of this very machine: installation, isolation, and whether it repeats its own bits."""

import contextlib
import os
import re
import signal
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from minitouch_bench.episode import EpisodeSpec, Role
from minitouch_bench.errors import InfrastructureError, MiniTouchError
from minitouch_bench.evaluation.actors import RecordedActor, Recording
from minitouch_bench.evaluation.rollout import ActorSource, EpisodeRunner, LocalEngine
from minitouch_bench.files import cache_directory, cache_file
from minitouch_bench.machine import extras, installed_versions
from minitouch_bench.policies.isolate import isolate, try_policy
from minitouch_bench.policies.kernel import supported_abi
from minitouch_bench.policies.policy import zero_observation
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL
from minitouch_bench.runs.actions import Actions
from minitouch_bench.runs.plan import suite_episodes
from minitouch_bench.shapegen.manifest import canonical_shape_set
from minitouch_bench.simulation.client import BUILDS
from minitouch_bench.tasks.environment import TASK_CLASSES, MiniTouchEnv
from minitouch_bench.verification.golden import golden_bits, recorded

EPISODES_PER_TASK = 2
STEPS = 25
"""Random control steps of each trial episode: long enough to reach contact in most tasks."""

POLICY_STEPS = 5
Bits = dict[str, str]
"""The digest of each trial episode by its key."""


class CheckResult(StrEnum):
    """What came of a check; a note is worth knowing and no fault."""

    OK = "ok"
    NOTE = "note"
    FAIL = "fail"


@dataclass(frozen=True)
class Check:
    """One thing that was looked at."""

    name: str
    verdict: CheckResult
    text: str


def examine(workers: int) -> Iterator[Check]:
    """Make every check in turn and yield it; nothing is left behind but the cache."""
    for name, look in (
        ("packages", _packages),
        ("cache", _cache),
        ("protocol and shapes", _protocol),
        ("isolation", _isolation),
        ("policy repeats", _policy_repeats),
    ):
        try:
            yield Check(name, CheckResult.OK, look())
        except MiniTouchError as error:
            yield _failed(name, error)
    try:
        yield from _simulation(workers)
    except MiniTouchError as error:
        yield _failed("simulation", error)


def trial_episodes() -> tuple[tuple[EpisodeSpec, ...], Recording]:
    """Return some episodes of every task, and random actions for them."""
    specs = tuple(
        spec for spec in suite_episodes(PROTOCOL.suite("smoke")) if spec.index < EPISODES_PER_TASK
    )
    actions: dict[str, Actions] = {}
    for spec in specs:
        size = PROTOCOL.task(spec.task).action_size
        rng = np.random.default_rng(spec.seed)
        actions[spec.key] = rng.uniform(-1, 1, (STEPS, size)).astype(np.float32)
    return specs, Recording(actions)


@dataclass(frozen=True, kw_only=True)
class CrashingOnce(Recording):
    """A recording whose first episode kills its worker, as a crash of the machine would."""

    marker: Path

    def make_actor(self, role: Role) -> RecordedActor:
        """Return an actor that looks for the marker, and dies where there is none."""
        return _Crasher(self.actions, self.marker)


class _Crasher(RecordedActor):
    def __init__(self, actions: Mapping[str, Actions], marker: Path) -> None:
        super().__init__(actions)
        self._marker = marker

    def reset(self, environment: MiniTouchEnv, spec: EpisodeSpec) -> None:
        if not self._marker.exists():
            self._marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        super().reset(environment, spec)


def _failed(name: str, error: MiniTouchError) -> Check:
    return Check(name, CheckResult.FAIL, str(error).replace("\n", " "))


def _packages() -> str:
    versions = {name: version(name) for name in ("minitouch-bench", "torch", "numpy", "gymnasium")}
    listed = ", ".join(
        f"{name} {number}" for name, number in {**versions, **installed_versions(BUILDS)}.items()
    )
    absent = [
        extra
        for extra, needed in extras().items()
        if extra != "dev" and not all(map(_is_installed, needed))
    ]
    hint = f"; without the extras {', '.join(absent)}" if absent else "; every extra"
    return listed + hint


def _is_installed(requirement: str) -> bool:
    try:
        return bool(version(re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0]))
    except PackageNotFoundError:
        return False


def _cache() -> str:
    cache_file("doctor", ".txt", b"written by minitouch-bench doctor\n")
    return f"{cache_directory()} can be written"


def _protocol() -> str:
    shapes = canonical_shape_set()
    return (
        f"{PROTOCOL.name} {PROTOCOL.digest()[:12]}; {len(shapes.split('train'))} train and "
        f"{len(shapes.split('held-out'))} held-out shapes, {shapes.digest[:12]}"
    )


def _isolation() -> str:
    try_policy(parse_source("zero"), ("pushing",))
    return f"a sandbox was tried and works: seccomp, Landlock {supported_abi()}"


def _policy_repeats() -> str:
    """Load one new checkpoint in two fresh sandboxes, and compare their actions."""
    from minitouch_bench.policies.native import save_native  # noqa: PLC0415
    from minitouch_bench.policies.networks import TouchActor  # noqa: PLC0415  torch takes seconds

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "doctor.safetensors"
        save_native(TouchActor(action_size=4), path)
        answers = [_answers(path) for _ in range(2)]
    if answers[0] != answers[1]:
        raise InfrastructureError("a checkpoint gave other bits the second time")
    return "a torch checkpoint gave the same bits in two fresh sandboxes"


def _answers(checkpoint: Path) -> list[bytes]:
    with contextlib.closing(isolate(parse_source(str(checkpoint)))) as policy:
        policy.reset(7, "pushing")
        return [policy.act(zero_observation()).tobytes() for _ in range(POLICY_STEPS)]


def _simulation(workers: int) -> Iterator[Check]:
    specs, recording = trial_episodes()
    here = _run_here(recording, specs)
    began = time.monotonic()
    fresh = _run(1, recording, specs)
    elapsed = time.monotonic() - began
    yield _same("fresh process repeats", here, fresh, "in another process")
    shuffled = np.random.default_rng().permutation(len(specs))
    several = max(workers, 2)
    bits = _run(several, recording, [specs[i] for i in shuffled])
    yield _same("order and workers", here, bits, f"with {several} workers in another order")
    with tempfile.TemporaryDirectory() as folder:
        crashed = _run(
            1, CrashingOnce(actions=recording.actions, marker=Path(folder) / "died"), specs
        )
    yield _same("crash", here, crashed, "after a worker was killed in mid-run")
    yield _reference()
    yield _speed(len(specs) * STEPS / elapsed, workers)


def _run_here(source: ActorSource, specs: Sequence[EpisodeSpec]) -> Bits:
    with contextlib.closing(EpisodeRunner(source)) as runner:
        return {spec.key: runner.run(spec).trace.digest() for spec in specs}


def _run(workers: int, source: ActorSource, specs: Sequence[EpisodeSpec]) -> Bits:
    engine = LocalEngine(workers)
    return {record.spec.key: record.trace.digest() for record in engine.run(source, specs)}


def _same(name: str, here: Bits, again: Bits, how: str) -> Check:
    other = sorted(key for key in here if here[key] != again.get(key))
    if other:
        return Check(name, CheckResult.FAIL, f"other bits {how}: {', '.join(other)}")
    return Check(
        name, CheckResult.OK, f"{len(here)} episodes of {len(TASK_CLASSES)} tasks, same bits {how}"
    )


def _reference() -> Check:
    """Compare with the bits recorded on the machine that this version was released from."""
    other = [task for task, golden in recorded().items() if golden_bits(task) != golden.bits]
    if not other:
        return Check("reference bits", CheckResult.OK, "this machine simulates the recorded bits")
    return Check(
        "reference bits",
        CheckResult.NOTE,
        f"other bits than recorded in {', '.join(other)}: success rates compare, digests do not",
    )


def _speed(steps_per_s: float, workers: int) -> Check:
    suite = PROTOCOL.suite(MAIN_SUITE)
    steps = suite.episodes_per_task * sum(PROTOCOL.task(t).max_steps for t in suite.tasks)
    minutes = steps / steps_per_s / workers / 60
    by = f"{workers} worker{'s' if workers > 1 else ''}"
    return Check(
        "speed",
        CheckResult.NOTE,
        f"{steps_per_s:.0f} control steps/s a worker, start included; {suite.name} "
        f"(at most {steps:,} steps) in {minutes:.0f} min with {by}, without the policy's own time",
    )
