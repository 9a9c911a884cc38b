"""Plausible runs without a simulator: records that look like those of an evaluation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from minitouch_bench.episode import (
    Episode,
    EpisodeSpec,
    Outcome,
    PlayedEpisode,
    PolicyIdentity,
    Role,
    Start,
    Trace,
)
from minitouch_bench.files import RUN_FILE, write_file
from minitouch_bench.machine import RunEnvironment
from minitouch_bench.metrics.summary import Summary, measure
from minitouch_bench.runs.plan import Plan
from minitouch_bench.runs.run import (
    Run,
    RunHeader,
    make_header,
    parse_run,
    read_run,
    run_json,
)
from minitouch_bench.runs.run import make_run as measure_run


@dataclass(frozen=True)
class Played:
    """What an evaluation gives before its episodes are measured."""

    header: RunHeader
    environment: RunEnvironment
    records: tuple[PlayedEpisode, ...]

    @property
    def plan(self) -> Plan:
        return self.header.plan


FAMILIES = ("carved", "extruded", "harmonic", "lathed")
SHAPE_TASKS = ("playing", "pushing", "pick-up")
ALL_TASKS = ("playing", "pushing", "opening", "pick-up")
LIMIT = 200
FAULT = "act() gave NaN in element 2 of 4"
ENVIRONMENT = RunEnvironment(
    packages={"minitouch-bench": "0.1.0", "pybullet": "3.2.7", "numpy": "2.4.6"},
    machine={"system": "Linux 6.8", "processor": "x86_64, 8 cores", "python": "3.11.9"},
    workers=8,
    started="2025-03-04T10:20:30Z",
    wall_s=754.2,
)


def make_trace(rng: np.random.Generator, steps: int, task: str, contact: float) -> Trace:
    ticks = rng.integers(8, 40, steps).astype(np.int16)
    reach = int(rng.integers(4, 30))
    touching = (np.arange(steps) > reach) & (rng.random(steps) < contact)
    contact_ticks = np.where(touching, (ticks * rng.uniform(0.2, 0.9, steps)), 0).astype(np.int16)
    began = np.diff(np.concatenate([[False], contact_ticks > 0]).astype(int)) > 0
    axes = 1 if task == "opening" else 3
    touched = np.flatnonzero(contact_ticks)
    actions = rng.uniform(-1, 1, (steps, 5 if task == "opening" else 4)).astype(np.float32)
    clipped = rng.random(steps) < 0.03
    actions[clipped] = 1  # a clipped action is at a bound
    return Trace(
        actions=actions,
        clipped=clipped,
        rewards=np.zeros(steps, np.float32),
        ticks=ticks,
        contact_ticks=contact_ticks,
        onsets=began.astype(np.int16),
        touch=rng.normal(0, 3, (steps + 1, 11)).astype(np.float32),
        object_state=np.cumsum(rng.normal(0, 2e-3, (steps + 1, axes)), axis=0),
        first_touch_tick=int(ticks[: touched[0]].sum()) if touched.size else -1,
    )


def make_start(task: str, index: int) -> Start:
    rng = np.random.default_rng(index)
    place = lambda *ends: tuple(rng.uniform(*ends).tolist())  # noqa: E731
    x, y = place((0.45, -0.15), (0.65, 0.2))
    target = place((0.3, -0.15), (0.65, 0.2)) if task == "pushing" else None
    return Start((x, y, 0.0), 0.0, target, (0.5, 0.0, 0.04))


def make_record(rng: np.random.Generator, spec: EpisodeSpec, skill: float) -> PlayedEpisode:
    draw = rng.random()
    if spec.task == "playing":
        outcome, steps = Outcome.STEP_LIMIT, LIMIT
    elif draw < skill:
        outcome, steps = Outcome.SUCCESS, int(np.clip(rng.gamma(5, 9), 6, LIMIT))
    elif draw < skill + 0.6 * (1 - skill) and spec.task != "opening":
        outcome, steps = Outcome.LEFT_WORKSPACE, int(np.clip(rng.gamma(4, 20), 5, LIMIT))
    else:
        outcome, steps = Outcome.STEP_LIMIT, LIMIT
    trace = make_trace(rng, steps, spec.task, contact=0.25 + 0.6 * skill)
    if outcome is Outcome.SUCCESS:
        trace.rewards[-1] = 25
    return PlayedEpisode(spec, outcome, make_start(spec.task, spec.index), trace)


def with_fault(record: PlayedEpisode, text: str, steps: int = 0) -> PlayedEpisode:
    rng = np.random.default_rng(record.spec.index)
    trace = make_trace(rng, steps, record.spec.task, contact=0.0)
    return PlayedEpisode(record.spec, Outcome.POLICY_FAULT, record.start, trace, text)


def played(
    plan: Plan, policies: Mapping[Role, PolicyIdentity], skill: float, seed: int, faults: int = 0
) -> Played:
    """Make every episode of a plan, its policy as good as ``skill`` says."""
    rng = np.random.default_rng([seed, len(plan.suite), plan.episodes, int(1000 * skill)])
    records = []
    for spec in plan.specs(exploration=Role.EXPLORATION in policies):
        ease = skill / 2 if spec.role is Role.EXPLORATION else skill
        record = make_record(rng, spec, ease * (0.9 if spec.split == "held-out" else 1.0))
        if spec.task == "pushing" and spec.index < faults and spec.role is Role.FINAL:
            record = with_fault(record, FAULT, steps=spec.index)
        records.append(record)
    final = policies[Role.FINAL]
    isolation = "none" if final.kind == "scripted" else "sandbox"
    header = make_header(plan, final, policies.get(Role.EXPLORATION), isolation)
    return Played(header, ENVIRONMENT, tuple(records))


def make_run(  # noqa: PLR0917 - a fixture with defaults reads best as one call
    name: str = "hac-seed1",
    tasks: Sequence[str] = ALL_TASKS,
    episodes: int = 20,
    skill: float = 0.8,
    seed: int = 0,
    exploration: bool = True,
    faults: int = 0,
    notes: tuple[str, ...] = (),
    official: bool = True,
    digest: str = "5f1c9ad27e",
) -> Played:
    policies = {
        Role.FINAL: PolicyIdentity(
            name, f"checkpoints/{name}.safetensors", "native", "ab" * 32, notes
        )
    }
    if exploration:
        explorer = PolicyIdentity(f"{name}-exploration", "e.safetensors", "native", "cd" * 32)
        policies[Role.EXPLORATION] = explorer
    run = played(Plan("table4", tuple(tasks), episodes, 0), policies, skill, seed, faults)
    header = replace(
        run.header,
        protocol_digest=digest * 6,
        task_digests={task: f"{task} {digest}" for task in tasks},
        official=official,
        unofficial_because=() if official else (f"{episodes} of 100 episodes",),
    )
    return replace(run, header=header)


def with_shapes(run: Played) -> Played:
    """Give every episode a shape: held-out ones at even indices, train ones at odd ones."""
    records = []
    for record in run.records:
        turn = record.spec.index // 2
        # Held-out shapes miss the last family, train shapes have all.
        held_out = record.spec.index % 2 == 0
        family = FAMILIES[turn % (len(FAMILIES) - held_out)]
        split = "held-out" if held_out else "train"
        spec = replace(record.spec, shape=f"{split}-{turn}", family=family, split=split)
        records.append(replace(record, spec=spec))
    header = replace(run.header, plan=replace(run.plan, suite="novel-shapes"))
    return replace(run, header=header, records=tuple(records))


def save(run: Played, name: str = "a-run") -> Run:
    return parse_run(run_json(measured(run, name)), name)


def write(run: Played, directory: Path) -> Run:
    """Write the ``run.json`` of a run, and read it."""
    done = measured(run)
    write_file(directory / RUN_FILE, run_json(done))
    return read_run(directory)


def measured(run: Played, name: str = "a-run") -> Run:
    return measure_run(run.header, run.environment, run.records, name)


def summary_of(run: Played, seed: int = 3) -> Summary:
    plan = replace(run.plan, seed=seed)
    return measured(replace(run, header=replace(run.header, plan=plan))).summary


def rows_of(run: Played, role: Role = Role.FINAL) -> tuple[Episode, ...]:
    return tuple(measure(record) for record in run.records if record.spec.role is role)
