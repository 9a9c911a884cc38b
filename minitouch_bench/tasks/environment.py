"""One Gymnasium environment for all four tasks."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from minitouch_bench.errors import UsageError
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.records import Outcome
from minitouch_bench.sensing.camera import GreyCamera, Shadow
from minitouch_bench.sensing.observation import Observation, observation_space
from minitouch_bench.sensing.touch import read_touch
from minitouch_bench.simulation.client import PhysicsClient
from minitouch_bench.simulation.panda_arm import PandaArm
from minitouch_bench.simulation.panda_kinematics import PandaKinematics
from minitouch_bench.simulation.scene import add_table
from minitouch_bench.tasks.action import fit_action
from minitouch_bench.tasks.contact_watch import ContactWatch
from minitouch_bench.tasks.objects import ObjectModel, ObjectPool
from minitouch_bench.tasks.studio import Studio
from minitouch_bench.tasks.task import Task

Info = dict[str, Any]

OBSERVATION = PROTOCOL.observation


class MiniTouchEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A task seen through the 84 x 84 camera and the touch vector.

    Observations: ``image`` uint8 (1, 84, 84), ``touch`` float32 (11,). Actions: float32
    (4,), Opening (5,), in [-1, 1]; values outside are clipped and reported in ``info``.

    ``reset(options={"object": name})`` asks for one object of the pool; without it the
    object is drawn. ``info`` of a step: ``success``, ``outcome`` ("" until the end),
    ``ticks``, ``contact_ticks``, ``onsets``, ``first_touch_tick``, ``clipped``,
    ``object_state``, and the action as applied.

    Each reset builds its world anew, so an episode depends on its seed and actions alone.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012  Gymnasium's form

    def __init__(
        self,
        task: Task,
        pool: ObjectPool | None,
        render_mode: str | None = None,
        *,
        width: int = 480,
        height: int = 480,
        max_steps: int | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise UsageError(f"render_mode is 'rgb_array' or None, not '{render_mode}'")
        self.render_mode = render_mode
        self.task = task
        self._pool = pool
        self._size = (width, height)
        self._max_steps = max_steps or task.spec.max_steps
        spec = task.spec
        self.action_space = spaces.Box(-1.0, 1.0, (spec.action_size,), np.float32)
        # Gymnasium has no type for a Dict space whose samples are plain dicts.
        self.observation_space = observation_space(spec.force_limit)  # type: ignore[assignment]
        self.client = PhysicsClient()
        self._kinematics = PandaKinematics(spec.arm.posture)
        self._camera = GreyCamera(spec.camera)
        self._studio: Studio | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Build the world of a new episode."""
        super().reset(seed=seed)
        client, task = self.client, self.task
        model = self._choose_object((options or {}).get("object"))
        for _ in range(OBSERVATION.max_draws):
            self._build(model)
            seen = self._camera.visible_bodies(client)
            if all(
                (seen == body).sum() >= OBSERVATION.least_visible_pixels for body in task.landmarks
            ):
                break
        self._watch = ContactWatch(client, self.arm.body, task.target_body, task.target_links)
        self._steps = 0
        if self._studio is not None:
            self._studio.forget()
        return self._observe(), {"object": model.name if model else "", **self._state()}

    def _build(self, model: ObjectModel | None) -> None:
        """Draw where everything stands, and build that world."""
        client, task = self.client, self.task
        task.draw(self.np_random, model)
        client.reset_world()
        table = add_table(client)
        self._camera.keep_background(client, table, task.add_scenery(client))
        task.add_object(client)
        self.arm = PandaArm(client, self._kinematics, task.spec.arm)
        task.place_arm(self.arm)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, Info]:
        """Carry out one control step."""
        applied, clipped = self._checked(action)
        workspace, watch = self.task.spec.workspace, self._watch
        contact_ticks, onsets = watch.contact_ticks, watch.onsets
        ticks = self.arm.move(applied, workspace.low, workspace.high, watch.after_tick)
        self._steps += 1
        outcome = self.task.outcome(self.client)
        truncated = outcome is None and self._steps >= self._max_steps
        info = {
            "outcome": str(outcome or (Outcome.STEP_LIMIT if truncated else "")),
            "ticks": ticks,
            "contact_ticks": watch.contact_ticks - contact_ticks,
            "onsets": watch.onsets - onsets,
            "first_touch_tick": watch.first_tick,
            "action": applied,
            "clipped": clipped,
            **self._state(outcome),
        }
        reward = self.task.spec.success_reward if info["success"] else 0.0
        return self._observe(), reward, outcome is not None, truncated, info

    def render(self) -> NDArray[np.uint8] | None:
        """Return ``picture()`` if ``render_mode`` asks for it, else None."""
        return None if self.render_mode is None else self.picture()

    def picture(self) -> NDArray[np.uint8]:
        """Return a picture of the scene for people, uint8 (height, width, 3)."""
        if self._studio is None:
            self._studio = Studio(*self._size)
        return self._studio.picture(self.task, self.client)

    def close(self) -> None:
        """Free the worlds."""
        self.client.close()
        self._kinematics.close()
        if self._studio is not None:
            self._studio.close()

    def _choose_object(self, name: str | None) -> ObjectModel | None:
        if self._pool is None:
            return None
        return self._pool.model(name) if name else self._pool.draw(self.np_random)

    def _checked(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float32], bool]:
        """Return the action clipped to [-1, 1], and whether it had to be.

        Raises:
            InvalidActionError: wrong shape or kind, NaN or infinite; the world is untouched,
                which matters because one NaN would poison it for good.
        """
        given = fit_action(action, self.task.spec.action_size)
        return np.clip(given, -1.0, 1.0), bool((np.abs(given) > 1.0).any())

    def _observe(self) -> Observation:
        return {
            "image": self._camera.capture(self.client, self._shadows()),
            "touch": read_touch(self.arm, self.task.spec.force_limit),
        }

    def _shadows(self) -> tuple[Shadow, ...]:
        """Return the shadows of the hand and the object, where the camera can see any."""
        if not self.task.spec.shadows:
            return ()
        hand_x, hand_y, _ = self.arm.position
        object_x, object_y = self.client.pose(self.task.target_body).position[:2]
        return (
            Shadow(hand_x, hand_y, OBSERVATION.hand_shadow_radius),
            Shadow(object_x, object_y, OBSERVATION.object_shadow_radius),
        )

    def _state(self, outcome: Outcome | None = None) -> Info:
        return {
            "success": outcome is Outcome.SUCCESS,
            "object_state": self.task.object_state(self.client),
        }
