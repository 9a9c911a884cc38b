"""Checks of this very machine: installation, isolation, and whether it repeats its own bits."""

import contextlib
import hashlib
import json
import re
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files
from pathlib import Path

import numpy as np

from minitouch_bench.episode import EpisodeSpec, PlayedEpisode
from minitouch_bench.errors import InfrastructureError, MiniTouchError
from minitouch_bench.evaluation.engine import LocalEngine
from minitouch_bench.evaluation.policy_setup import Recording, try_policy
from minitouch_bench.evaluation.rollout import EpisodeRunner
from minitouch_bench.files import cache_directory, cache_file
from minitouch_bench.machine import extras, installed_versions
from minitouch_bench.policies.kernel import supported_abi
from minitouch_bench.policies.policy import zero_observation
from minitouch_bench.policies.policy_process import isolate
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.protocol.minitouch import MAIN_SUITE, PROTOCOL
from minitouch_bench.runs.actions import Actions
from minitouch_bench.runs.plan import make_plan
from minitouch_bench.shapegen.manifest import canonical_shape_set
from minitouch_bench.simulation.builds import BUILDS, check_library
from minitouch_bench.tasks.environment import MiniTouchEnv
from minitouch_bench.tasks.task import TASK_CLASSES

EPISODES_PER_TASK = 2
STEPS = 25
"""Random control steps of a trial or golden episode: enough to reach contact in most tasks."""

POLICY_STEPS = 5

GOLDEN_FILE = "golden.json"
"""The bits of the golden episodes; ``python -m benchmarks.golden`` records them."""
GOLDEN_SEED = 20211108


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
        ("simulator", check_library),
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


def _failed(name: str, error: MiniTouchError) -> Check:
    return Check(name, CheckResult.FAIL, str(error).replace("\n", " "))


def _packages() -> str:
    named = ("minitouch-bench", "torch", "numpy", "gymnasium", *BUILDS)
    listed = ", ".join(f"{name} {found}" for name, found in installed_versions(named).items())
    absent = []
    for extra, requirements in extras().items():
        needed = {re.split(r"[^A-Za-z0-9._-]", one, maxsplit=1)[0] for one in requirements}
        if extra not in ("dev", "docs") and installed_versions(needed).keys() != needed:
            absent.append(extra)
    return listed + (f"; without the extras {', '.join(absent)}" if absent else "; every extra")


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
    """Play the trial episodes here and by several workers, then the golden ones."""
    specs, recording = trial_episodes()
    began = time.monotonic()
    with contextlib.closing(EpisodeRunner(recording)) as runner:
        here = _bits(map(runner.run, specs))
    speed = len(specs) * STEPS / (time.monotonic() - began)
    several = max(workers, 2)
    shuffled = [specs[i] for i in np.random.default_rng().permutation(len(specs))]
    again = _bits(LocalEngine(several).run(recording, shuffled))
    how = f"bits with {several} workers in another order"
    verdict, what = CheckResult.OK, f"{len(here)} episodes of {len(TASK_CLASSES)} tasks, same {how}"
    if other := sorted(key for key in here if here[key] != again.get(key)):
        verdict, what = CheckResult.FAIL, f"other {how}: {', '.join(other)}"
    yield Check("order and workers", verdict, what)
    # The bits of the machine that this version was released from.
    verdict, what = CheckResult.OK, "this machine simulates the recorded bits"
    if other := [task for task, bits in recorded().items() if golden_bits(task) != bits]:
        verdict = CheckResult.NOTE
        what = (
            f"other bits than recorded in {', '.join(other)}: success rates compare, digests do not"
        )
    yield Check("reference bits", verdict, what)
    yield Check("speed", CheckResult.NOTE, _speed(speed, workers))


def trial_episodes() -> tuple[tuple[EpisodeSpec, ...], Recording]:
    """Return some episodes of every task, and random actions for them."""
    plan = make_plan("smoke", episodes=EPISODES_PER_TASK)
    actions: dict[EpisodeSpec, Actions] = {}
    for spec in plan.specs():
        size = PROTOCOL.task(spec.task).action_size
        rng = np.random.default_rng(spec.seed)
        actions[spec] = rng.uniform(-1, 1, (STEPS, size)).astype(np.float32)
    return plan.specs(), Recording(actions, plan)


def _bits(played: Iterable[PlayedEpisode]) -> dict[str, str]:
    """Return the digest of each episode by its key."""
    return {record.spec.key: record.trace.digest() for record in played}


def recorded() -> dict[str, str]:
    """Return the recorded digest of each task's golden episode.

    A task's own digest covers its values; code that changes an episode without changing a value
    changes this one.
    """
    text = files("minitouch_bench.verification").joinpath(GOLDEN_FILE).read_text("utf-8")
    return dict(json.loads(text))


def golden_bits(task: str, objects: str | None = None) -> str:
    """Return the SHA-256 over all that is observed in the task's golden episode.

    ``objects``: those of the task's constructor; by default the task's own.
    """
    sha = hashlib.sha256()
    rng = np.random.default_rng(GOLDEN_SEED)
    with contextlib.closing(MiniTouchEnv(task, objects=objects)) as environment:
        observation, info = environment.reset(seed=GOLDEN_SEED)
        for _ in range(STEPS):
            for array in (observation["image"], observation["touch"], info["object_state"]):
                sha.update(array.tobytes())
            size = environment.action_space.shape
            action = rng.uniform(-1.0, 1.0, size).astype(np.float32)
            observation, _, terminated, _, info = environment.step(action)
            sha.update(f"{info['ticks']} {info['contact_ticks']}".encode())
            if terminated:
                break
        sha.update(observation["image"].tobytes())
    return sha.hexdigest()


def _speed(steps_per_s: float, workers: int) -> str:
    suite = PROTOCOL.suite(MAIN_SUITE)
    steps = suite.episodes_per_task * sum(PROTOCOL.task(t).max_steps for t in suite.tasks)
    minutes = steps / steps_per_s / workers / 60
    by = f"{workers} worker{'s' if workers > 1 else ''}"
    return (
        f"{steps_per_s:.0f} control steps/s a worker; {suite.name} (at most {steps:,} steps) in "
        f"{minutes:.0f} min with {by}, without the policy's own time"
    )
