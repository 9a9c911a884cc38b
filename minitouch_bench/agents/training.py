"""The training loop of both phases, and its records: rows of ``progress.csv``."""

import time
from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from minitouch_bench.agents.config import TrainingConfig
from minitouch_bench.agents.learner import Learner, kept_size
from minitouch_bench.agents.memory import CheckpointFiles, ReplayMemory
from minitouch_bench.episode import Observation, Outcome
from minitouch_bench.errors import InvalidActionError, RunDirectoryError, UsageError
from minitouch_bench.evaluation.engine import Callbacks
from minitouch_bench.evaluation.execution import package_versions
from minitouch_bench.evaluation.recording import read_episodes
from minitouch_bench.evaluation.rollout import run_episode
from minitouch_bench.files import PROGRESS_FILE, os_errors_as, write_file
from minitouch_bench.policies.native import NativePolicy, save_native
from minitouch_bench.policies.networks import TOUCH_SIZE
from minitouch_bench.policies.sources import EXPLORED_FILE, TRAINED_FILE
from minitouch_bench.protocol.spec import TaskSpec
from minitouch_bench.reporting.tables import rows_csv
from minitouch_bench.runs.plan import Plan, PlannedObjects
from minitouch_bench.simulation.observation import FORCES
from minitouch_bench.tasks.environment import MiniTouchEnv

EVALUATION_SUITE = "training"
"""Seeds the episodes of a training's evaluations; no suite has this name."""


@dataclass(frozen=True, kw_only=True)
class ProgressRow:
    """The control steps since the row before; None where there is nothing to tell.

    ``phase``: "exploration" or "task".
    ``intrinsic_reward``: mean over the batches, as learned from; ``task_reward``: the task's
    own, per control step; ``touch_share``: share of control steps in contact; ``force``: mean over
    control steps of the larger of the two fingers' forces, N; ``success``:
    share of the ``episodes`` that ended. ``value`` is the critic's mean, ``entropy`` in
    nats. ``evaluation_*``: on episodes of their own, see ``evaluate_every`` in
    ``agents/config.py``.
    """

    step: int
    phase: str
    episodes: int
    intrinsic_reward: float | None = None
    task_reward: float | None = None
    touch_share: float | None = None
    force: float | None = None
    success: float | None = None
    curiosity_loss: float | None = None
    critic_loss: float | None = None
    actor_loss: float | None = None
    value: float | None = None
    entropy: float | None = None
    temperature: float | None = None
    evaluation_success: float | None = None
    evaluation_touch_share: float | None = None
    seconds: float


STEP_COLUMNS = ("task_reward", "touch_share", "force")
"""Columns that are means over control steps."""

COLUMNS = tuple(field.name for field in fields(ProgressRow))


class Tally:
    """Sums since the last row, by column; the row has their means."""

    def __init__(self) -> None:
        self.steps = self.episodes = self.updates = 0
        self.sums: dict[str, float | Tensor] = {}

    def add(self, values: Mapping[str, float | Tensor]) -> None:
        """Add values to their sums, without waiting for the device."""
        for name, value in values.items():
            self.sums[name] = self.sums.get(name, 0.0) + value

    def row(
        self, step: int, phase: str, evaluation: Mapping[str, float], seconds: float
    ) -> ProgressRow:
        """Return the row that these sums make, with the fields that an evaluation gives."""
        counts = {"success": self.episodes, **dict.fromkeys(STEP_COLUMNS, self.steps)}
        return ProgressRow(
            step=step,
            phase=phase,
            episodes=self.episodes,
            seconds=round(seconds, 1),
            **evaluation,
            **{n: float(total) / counts.get(n, self.updates) for n, total in self.sums.items()},
        )


class Training:
    """One training in its directory, from its first step or from its last checkpoint."""

    def __init__(self, config: TrainingConfig, directory: Path, device: torch.device) -> None:
        self.config = config
        self._directory = directory
        limit = config.episode_steps or None
        self._environment = MiniTouchEnv(
            config.task, config.objects or None, max_episode_steps=limit
        )
        self._world = MiniTouchEnv(config.task)  # of its evaluations
        plan = Plan(EVALUATION_SUITE, (config.task,), config.evaluate_episodes, config.seed)
        self._evaluated = plan.specs()
        spec = self._environment.task.spec
        self._learner = Learner(config, spec, device)
        features = kept_size(spec.action_size) if config.task_phase.keypoint_updates else 0
        self._memory = ReplayMemory(config.replay_size, TOUCH_SIZE, spec.action_size, features)
        self._files = CheckpointFiles(directory)
        self._objects = PlannedObjects.of(config.objects).digest if config.objects else ""
        self._made_with = {"device": device.type, **package_versions()}
        self._begun_with = self._made_with
        self._tally = Tally()
        self._rows: list[ProgressRow] = []
        self._observation: Observation
        self._episode = -1
        self._seconds = 0.0
        self.step = 0

    def close(self) -> None:
        """End the worlds."""
        self._environment.close()
        self._world.close()

    def start(self, *, fresh: bool = False) -> None:
        """Begin, or go on from the last checkpoint, if there is one and not ``fresh``.

        Raises:
            RunDirectoryError: a file of it is damaged.
            UsageError: the recorded dataset cannot be read.
        """
        self._clock = time.perf_counter()
        if self._files.exists() and not fresh:
            self._resume()
        else:
            self._begin()
        if not fresh:
            self._write_rows()

    def run(self, callbacks: Callbacks) -> bool:
        """Train to the end and return True, or False where it was asked to stop before.

        Raises:
            RunDirectoryError: a file cannot be written; the last checkpoint is kept.
            InvalidActionError: the training diverged, so that the policy gives no numbers.
        """
        self._callbacks = callbacks
        for name, before in self._begun_with.items():
            if (now := self._made_with.get(name)) != before:
                what = f"begun with {name} {before}, continued with {now or 'none'}"
                callbacks.note(f"{what}: the result may differ from an uninterrupted training's")
        while self.step < self.config.steps:
            if self._callbacks.should_stop():
                self._save()
                return False
            if self.step == self.config.task_phase_begin:
                self._begin_task_phase()
            if self._is_from_dataset:
                self.step += 1
            else:
                self._control_step()
            for _ in range(self._updates_due()):
                self._tally.updates += 1
                self._tally.add(self._learner.update(self._memory, self._phase_step))
            self._keep_records()
        self._finish()
        return True

    def _write_rows(self) -> None:
        """Write ``progress.csv`` whole, so without rows after the checkpoint; none has no file.

        Raises:
            RunDirectoryError: there is no room, or no permission.
        """
        file = self._directory / PROGRESS_FILE
        if self._rows:
            write_file(file, rows_csv(COLUMNS, map(astuple, self._rows)))
        else:
            with os_errors_as(RunDirectoryError, file, "removed"):
                file.unlink(missing_ok=True)

    def _begin(self) -> None:
        if self.config.dataset:
            task = self._environment.task.spec
            fill_from_dataset(self._memory, Path(self.config.dataset), task)
        if not self._is_from_dataset:
            self._begin_episode()

    @property
    def _is_from_dataset(self) -> bool:
        """Tell whether the step under way is one of an exploration of recorded data."""
        return bool(self.config.dataset) and self._learner.exploring

    @property
    def _phase_step(self) -> int:
        """Return the control steps of the phase under way so far."""
        return self.step - (0 if self._learner.exploring else self.config.exploration_steps)

    def _control_step(self) -> None:
        if not self.config.dataset and self.step < self.config.random_steps:
            action = self._learner.act_at_random()
        else:
            action = self._learner.act(self._observation)
        observation, reward, terminated, truncated, info = self._environment.step(action)
        success = bool(info["is_success"])
        self._memory.add(
            action,
            reward,
            observation["image"],
            observation["touch"],
            success=success,
            ended=terminated,
        )
        force = np.linalg.norm(observation["touch"][FORCES].reshape(2, 3), axis=1).max()
        touched = float(info["contact_ticks"] > 0)
        self._tally.steps += 1
        self._tally.add({"task_reward": reward, "touch_share": touched, "force": float(force)})
        self._observation = observation
        self.step += 1
        if terminated or truncated:
            self._tally.episodes += 1
            self._tally.add({"success": float(success)})
            self._begin_episode()

    def _begin_episode(self) -> None:
        self._episode += 1
        self._observation, _ = self._environment.reset(seed=self._episode_seed())
        self._memory.begin_episode(self._observation["image"], self._observation["touch"])

    def _episode_seed(self) -> int:
        sequence = np.random.SeedSequence([self.config.seed, self._episode])
        return int(sequence.generate_state(1, np.uint32)[0])

    def _updates_due(self) -> int:
        """Return the gradient steps to do now, so that their share comes out in the end."""
        learned = self.step - (0 if self.config.dataset else self.config.random_steps)
        if learned <= 0:
            return 0
        rate = self._learner.phase.updates_per_step
        return int(learned * rate) - int((learned - 1) * rate)

    def _begin_task_phase(self) -> None:
        phase, from_dataset = self.config.task_phase, self._is_from_dataset
        if self._learner.exploring:
            save_native(self._learner.actor(), self._directory / EXPLORED_FILE)
        if phase.keypoint_updates:
            keypoints = f"{phase.keypoint_updates:,} gradient steps of keypoints, "
            self._callbacks.note(
                f"new networks for the task: {keypoints if phase.learns_keypoints else ''}"
                f"{phase.fitting_updates:,} gradient steps of actor and critics"
            )
        self._learner.begin_task_phase(self._memory)
        if from_dataset:
            self._begin_episode()

    def _keep_records(self) -> None:
        """Write what is due after a control step: a row, an evaluation in it, a checkpoint."""
        due = self.config.evaluate_every
        is_evaluated = bool(due) and self.step % due == 0
        is_last_of_phase = self.step in (self.config.exploration_steps, self.config.steps)
        if is_evaluated or is_last_of_phase or self.step % self.config.log_every == 0:
            self._write_row(is_evaluated=is_evaluated)
        if self.step % self.config.checkpoint_every == 0:
            self._save()

    def _write_row(self, *, is_evaluated: bool) -> None:
        evaluation = self._evaluate() if is_evaluated else {}
        phase = "exploration" if self._learner.exploring else "task"
        row = self._tally.row(self.step, phase, evaluation, self._elapsed())
        self._rows.append(row)
        self._write_rows()
        self._callbacks.row(row)
        self._tally = Tally()

    def _evaluate(self) -> dict[str, float]:
        """Return the shares of success and touch over the same episodes each time, as in a row."""
        policy = NativePolicy(self._learner.actor(), not self._learner.exploring)
        records = [run_episode(self._world, policy, spec) for spec in self._evaluated]
        touched = np.concatenate([record.trace.contact_ticks > 0 for record in records])
        success = np.mean([record.outcome is Outcome.SUCCESS for record in records])
        return {
            "evaluation_success": float(success),
            "evaluation_touch_share": float(touched.mean()),
        }

    def _elapsed(self) -> float:
        """Return the seconds spent since the first step, over all resumptions."""
        now = time.perf_counter()
        self._seconds += now - self._clock
        self._clock = now
        return self._seconds

    def _finish(self) -> None:
        actor = self._learner.actor()
        if not all(bool(weight.isfinite().all()) for weight in actor.state_dict().values()):
            raise InvalidActionError("a weight of the policy is NaN or infinite")
        if self._learner.exploring:
            save_native(actor, self._directory / EXPLORED_FILE)
        save_native(actor, self._directory / TRAINED_FILE)
        self._save()

    def _save(self) -> None:
        self._files.save(self._state(), self._memory)

    def _state(self) -> dict[str, Any]:
        """Return everything but the replay memory."""
        return {
            "step": self.step,
            "episode": self._episode,
            "seconds": self._elapsed(),
            "tally": vars(self._tally),
            "rows": [asdict(row) for row in self._rows],
            "learner": self._learner.state(),
            "objects": self._objects,
            "made_with": self._made_with,
        }

    def _resume(self) -> None:
        """Load the checkpoint, and bring the world back by doing the episode's actions again.

        Raises:
            RunDirectoryError: the checkpoint is damaged, or of a training with other objects.
        """
        state = self._files.load(self._memory)
        if state["objects"] != self._objects:
            raise RunDirectoryError(
                f"{self.config.objects} is not the set of objects with which the training in "
                f"{self._directory} was begun.\n"
                "Put that set there, or begin again with --fresh or another --output"
            )
        with self._files.damage_named():
            self.step, self._episode = state["step"], state["episode"]
            self._seconds = state["seconds"]
            vars(self._tally).update(state["tally"])
            self._rows = [ProgressRow(**row) for row in state["rows"]]
            self._learner.load_state(state["learner"])
            self._begun_with = state.get("made_with", self._made_with)  # absent in older ones
        if self._is_from_dataset:
            return
        self._observation, _ = self._environment.reset(seed=self._episode_seed())
        for action in self._memory.episode_actions():
            self._observation = self._environment.step(action)[0]


def fill_from_dataset(memory: ReplayMemory, path: Path, task: TaskSpec) -> None:
    """Fill the replay memory with the episodes of a recorded dataset.

    Raises:
        MissingExtraError: the package that reads it is not installed.
        UsageError: there is no such dataset, it is of another environment, damaged, without a
            control step or larger than the memory.
    """
    for episode in read_episodes(path, task):
        memory.begin_episode(episode.images[0], episode.touch[0])
        for step, action in enumerate(episode.actions):
            memory.add(
                action,
                float(episode.rewards[step]),
                episode.images[step + 1],
                episode.touch[step + 1],
                success=bool(episode.success[step]),
                ended=bool(episode.ended[step]),
            )
    if not memory.rows:
        raise UsageError(f"{path} contains no control step")
    if memory.rows > memory.capacity:
        raise UsageError(
            f"{path} contains {memory.rows:,} observations, the memory {memory.capacity:,}: set a "
            "larger replay_size"
        )
