"""One Gymnasium environment for all tasks."""

from dataclasses import replace
from typing import Any, NoReturn, SupportsFloat

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import EzPickle, RecordConstructorArgs
from numpy.typing import NDArray

from minitouch_bench.episode import Observation, Outcome, Start
from minitouch_bench.errors import UsageError
from minitouch_bench.json_io import checked
from minitouch_bench.perturbation import AS_USUAL, UNPERTURBED, Perturbation
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.protocol.spec import CameraSpec, fit_action
from minitouch_bench.shapegen.manifest import Objects
from minitouch_bench.simulation.bodies import PORTRAIT_PANDA, add_table
from minitouch_bench.simulation.client import PhysicsClient, pixels_of
from minitouch_bench.simulation.observation import (
    ContactWatch,
    GrayCamera,
    Shadow,
    observation_space,
    read_touch,
    seen_on_plane,
    take_out,
)
from minitouch_bench.simulation.panda_arm import PandaArm, PandaKinematics
from minitouch_bench.tasks.task import TASK_CLASSES, ObjectModel, ObjectPool, Task

Info = dict[str, Any]

OBJECT = "object"
"""The one option of ``reset``; "" asks for none."""

OUTCOMES = (None, Outcome.SUCCESS, Outcome.LEFT_WORKSPACE, Outcome.STEP_LIMIT)
"""What the numbers of ``info["outcome"]`` mean; 0 while the episode goes on."""

OBSERVATION = PROTOCOL.observation


class MiniTouchEnv(gymnasium.Env[Observation, NDArray[np.float32]], EzPickle):
    """A task seen through the gray camera and the touch vector.

    Observations: ``image`` uint8 (1, H, W), ``touch`` float32 (11,). Actions: float32 (4,),
    Opening (5,), in [-1, 1]; values outside are clipped and reported in ``info``, and 4 or 5
    numbers are accepted everywhere (see ``fit_action``).

    ``objects``: "cube" (the task's own), a split of the canonical shape set ("train",
    "held-out", "all"), the names of its shapes, or a set of your own: its
    folder, or what ``shapegen.manifest.load_shape_set`` reads; None takes the task's default.
    ``reset(options={"object": name})`` asks for one object; without it one is drawn.
    ``render_mode="rgb_array"`` draws for people, ``width`` x ``height`` pixels.
    ``max_episode_steps``: control steps after which an episode ends; None takes the task's.
    ``perturbation`` may change the object's mass and friction, the fingers' motor force, and turn
    the camera; what it changes in the senses, an evaluation does.

    ``info`` has the same keys in ``reset`` and ``step``, with numpy values only:
    ``is_success`` and ``success``; ``outcome``, an index of ``OUTCOMES``; ``ticks``,
    ``contact_ticks`` and ``onsets`` of the step; ``first_touch_tick`` of the episode, -1 if
    there was none; ``object_state``; the ``action`` as applied, and whether it was ``clipped``.

    Each reset builds its world again, so an episode depends on its seed and actions alone. A
    world cannot be copied; pickling gives an equal new environment.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 4}  # noqa: RUF012  Gymnasium's form

    @checked
    def __init__(
        self,
        task: str,
        objects: Objects | None = None,
        render_mode: str | None = None,
        *,
        width: int = 240,
        height: int = 240,
        max_episode_steps: int | None = None,
        perturbation: Perturbation = UNPERTURBED,
    ) -> None:
        limits = {"width": width, "height": height, "max_episode_steps": max_episode_steps}
        EzPickle.__init__(self, task, objects, render_mode, **limits, perturbation=perturbation)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise UsageError(f"render_mode is 'rgb_array' or None, not '{render_mode}'")
        if min(width, height) < 1 or (max_episode_steps or 1) < 1:
            raise UsageError("width, height and max_episode_steps are numbers from 1 on")
        self.render_mode = render_mode
        self.task = TASK_CLASSES[PROTOCOL.task(task).name]()
        self._pool = self._objects(objects)
        self._size = (width, height)
        spec = self.task.spec
        self._max_steps = max_episode_steps or spec.max_steps
        self.perturbation = perturbation
        self.drawn = AS_USUAL
        """What this episode has of ``perturbation``."""
        self.action_space = spaces.Box(-1.0, 1.0, (spec.action_size,), np.float32)
        # Gymnasium has no type for a Dict space whose samples are plain dicts.
        self.observation_space = observation_space(spec.force_limit)  # type: ignore[assignment]
        self._steps = -1  # before the first reset
        self.client = PhysicsClient()
        self._kinematics = PandaKinematics(spec.arm.posture)
        self._camera = GrayCamera(spec.camera)
        self._renderer: HumanRenderer | None = None

    @checked
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Info]:
        """Build the world of a new episode.

        Raises:
            UsageError: an unknown option, no such object, or one that is too small to be seen.
        """
        super().reset(seed=seed)
        client, task = self.client, self.task
        if self.perturbation != UNPERTURBED:
            self.drawn = self.perturbation.draw(self.np_random.spawn(1)[0])
            camera = task.spec.camera
            self._camera = GrayCamera(replace(camera, yaw=camera.yaw + self.drawn.camera))
        model = self._choose_object(options or {})
        self.object_name = model.name if model else ""
        least = OBSERVATION.least_visible_pixels
        for _ in range(OBSERVATION.max_draws):
            self._build(model)
            seen = self._camera.visible_bodies(client)
            if all((seen == body).sum() >= least for body in task.visible_bodies):
                break
        else:
            raise UsageError(
                f"{self.object_name or task.spec.name}: less than {least} pixels are visible in "
                f"each of {OBSERVATION.max_draws} scenes"
            )
        self._watch = ContactWatch(client, self.arm.body, task.target_body, task.target_links)
        self._steps = 0
        if self._renderer is not None:
            self._renderer.forget()
        return self._observe(), self._info(np.zeros(task.spec.action_size, np.float32))

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, Info]:
        """Carry out one control step.

        Raises:
            InvalidActionError: wrong shape or kind, NaN or infinite; the world is untouched,
                which matters because one NaN would spoil it for good.
            ResetNeeded: before the first reset, also of an unpickled environment.
        """
        if self._steps < 0:
            raise ResetNeeded("reset the environment before its first step")
        given = fit_action(action, self.task.spec.action_size)
        applied = np.clip(given, -1.0, 1.0)
        workspace = self.task.spec.workspace
        self._watch.begin_step()
        self.arm.move(applied, workspace.low, workspace.high, self._watch.after_tick)
        self._steps += 1
        outcome = self.task.outcome(self.client)
        truncated = outcome is None and self._steps >= self._max_steps
        ended = Outcome.STEP_LIMIT if truncated else outcome
        info = self._info(applied, ended, clipped=bool((given != applied).any()))
        reward = self.task.reward(self.client, outcome)
        return self._observe(), reward, outcome is not None, truncated, info

    def start(self) -> Start:
        """Return where the objects and the end effector are, which a reset has just placed."""
        return self.task.start(self.client, self.arm.position)

    def render(self) -> NDArray[np.uint8] | None:
        """Return ``picture()`` if ``render_mode`` asks for it, else None."""
        return None if self.render_mode is None else self.picture()

    def picture(self) -> NDArray[np.uint8]:
        """Return an image of the scene for human viewers, uint8 (height, width, 3)."""
        if self._renderer is None:
            self._renderer = HumanRenderer(*self._size)
        return self._renderer.picture(self.task, self.client)

    def close(self) -> None:
        """Free the worlds."""
        self.client.close()
        self._kinematics.close()
        if self._renderer is not None:
            self._renderer.close()

    def __deepcopy__(self, memo: dict[int, Any]) -> NoReturn:
        raise TypeError(
            "a MiniTouch environment cannot be copied: its world is the simulator's. "
            "Make another one, or replay its actions from the same seed"
        )

    def _objects(self, objects: Objects | None) -> ObjectPool | None:
        """Return the objects to draw from, None where the task has none to choose."""
        cube, spec = self.task.own_object(), self.task.spec
        chosen = spec.default_objects if objects is None else objects
        if cube is None and chosen:
            raise UsageError(f"{spec.name} has no object to choose")
        return ObjectPool(cube, chosen) if cube else None

    def _build(self, model: ObjectModel | None) -> None:
        client, task = self.client, self.task
        task.draw(self.np_random, model)
        client.reset_world()
        table = add_table(client)
        self._camera.keep_background(client, table, task.add_scenery(client))
        task.add_object(client)
        factors = self.drawn.mass, self.drawn.friction
        if factors != (1.0, 1.0):
            client.scale_body(task.target_body, task.target_links, *factors)
        left, right = (self.drawn.grip * force for force in task.spec.arm.motor_force)
        arm = replace(task.spec.arm, motor_force=(left, right))
        self.arm = PandaArm(client, self._kinematics, arm)
        task.place_arm(self.arm)

    def _choose_object(self, options: dict[str, Any]) -> ObjectModel | None:
        if unknown := options.keys() - {OBJECT}:
            raise UsageError(f"no reset option '{min(map(str, unknown))}'; there is '{OBJECT}'")
        name = options.get(OBJECT)
        if not isinstance(name, str | None):
            raise UsageError(f"the reset option '{OBJECT}' is a name, not {name!r}")
        if self._pool is None:
            if name:
                raise UsageError(f"{self.task.spec.name} has no object to choose")
            return None
        return self._pool.model(name) if name else self._pool.draw(self.np_random)

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
            (hand_x, hand_y, OBSERVATION.hand_shadow_radius),
            (object_x, object_y, OBSERVATION.object_shadow_radius),
        )

    def _info(
        self,
        action: NDArray[np.float32],
        outcome: Outcome | None = None,
        *,
        clipped: bool = False,
    ) -> Info:
        """Return the info of the step that has just been done."""
        # Arrays, for vector environments stack no numpy.bool_.
        success = np.array(outcome is Outcome.SUCCESS)
        return {
            "is_success": success,
            "success": success.copy(),
            "outcome": np.int64(OUTCOMES.index(outcome)),
            "ticks": np.int64(self._watch.ticks),
            "contact_ticks": np.int64(self._watch.contact_ticks),
            "onsets": np.int64(self._watch.onsets),
            "first_touch_tick": np.int64(self._watch.first_tick),
            "object_state": self.task.object_state(self.client),
            "action": action,
            "clipped": np.array(clipped),
        }


class EpisodeEnd(
    gymnasium.Wrapper[Observation, NDArray[np.float32], Observation, NDArray[np.float32]],
    RecordConstructorArgs,
):
    """The end of an episode under Gymnasium's ``TimeLimit``, as the environment itself shows it.

    The limit is an outcome in ``info``, and a success in the last step is not truncated.
    """

    def __init__(self, env: gymnasium.Env[Observation, NDArray[np.float32]]) -> None:
        RecordConstructorArgs.__init__(self)
        super().__init__(env)

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[Observation, SupportsFloat, bool, bool, Info]:
        """Carry out one control step."""
        observation, reward, terminated, limited, info = self.env.step(action)
        truncated = limited and not terminated
        if truncated:
            info = {**info, "outcome": np.int64(OUTCOMES.index(Outcome.STEP_LIMIT))}
        return observation, reward, terminated, truncated, info


LAMP = CameraSpec((0.45, 0.0, 0.0), -60.0, -65.0, near=1.0, distance=2.5, field_of_view=34.0)
"""The light of pictures for people, as a camera that looks where it shines."""
LAMP_PIXELS = (160, 160)
SHADE = 0.88
"""Light that is left where the arm or the object is between the lamp and the table."""


class HumanRenderer:
    """A second world, only ever drawn: built in the same order, and posed as the simulated one.

    As in ``GrayCamera``, what never moves is drawn once an episode. Shadows fall on the table
    alone: where the lamp sees something else, which costs a fifth of the renderer's own shadows.
    """

    def __init__(self, width: int, height: int) -> None:
        self._client = PhysicsClient()
        self._size = (width, height)
        self._built_for: Task | None = None

    def close(self) -> None:
        """Free its world."""
        self._client.close()

    def forget(self) -> None:
        """Build the scene again at the next picture, because it has changed."""
        self._built_for = None

    def picture(self, task: Task, simulated: PhysicsClient) -> NDArray[np.uint8]:
        """Return a picture of the simulated world as it is, uint8 (height, width, 3)."""
        if self._built_for is not task:
            self._build(task)
        self._client.mirror(simulated)
        image = self._client.render(task.spec.portrait, *self._size)
        in_light = self._client.render(LAMP, *LAMP_PIXELS).depth == 1.0
        light = np.where(self._is_table & ~in_light[self._lamp_pixel], SHADE, 1.0)
        hidden = image.depth >= self._background.depth
        lit = self._background.rgb * light[..., np.newaxis]
        return np.where(hidden[..., np.newaxis], lit, image.rgb).astype(np.uint8)

    def _build(self, task: Task) -> None:
        client, camera = self._client, task.spec.portrait
        client.reset_world()
        table = add_table(client)
        static = {(table, -1), *task.add_scenery(client)}
        self._background = take_out(client, camera, self._size, static)
        task.add_object(client)
        client.load_urdf(PORTRAIT_PANDA, fixed=True)
        self._is_table = self._background.bodies == table
        x, y = seen_on_plane(camera, PROTOCOL.physics.table_top, self._size)
        self._lamp_pixel = pixels_of(LAMP, x, y, PROTOCOL.physics.table_top, LAMP_PIXELS)
        self._built_for = task
