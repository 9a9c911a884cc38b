"""What the world is like: contacts, forces, depths and pictures over resets and random episodes.

``python -m benchmarks.world [EPISODES] [RESETS] [TASK...]``: 50, 500 and every task by default,
a task per process.
"""

import multiprocessing
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.protocol.minitouch import PROTOCOL, TASK_NAMES
from minitouch_bench.simulation.client import pybullet
from minitouch_bench.simulation.observation import FORCES
from minitouch_bench.tasks.environment import MiniTouchEnv

FIRST_SEED = 6_000_000
TABLE = 0
FINGERS = (9, 10)
DISCOVERED_RAD = np.radians(5.0)


@dataclass(frozen=True)
class Felt:
    """What the fingers felt in one episode of T control steps.

    ``forces`` float32 (T, 6) in N, clipped, at the end of each step; ``touched`` bool (T,):
    contact at any tick; ``both``: at some tick with both fingers.
    """

    forces: NDArray[np.float32]
    touched: NDArray[np.bool_]
    both: NDArray[np.bool_]


def felt_in_words(episodes: Sequence[Felt]) -> str:
    """Return what is compared with the release (docs/reference/protocol.md)."""
    touched = np.concatenate([one.touched for one in episodes])
    size = np.linalg.norm(np.concatenate([one.forces for one in episodes]), axis=1)
    first = [int(one.touched.argmax()) + 1 for one in episodes if one.touched.any()]
    above = np.median(size[touched]) - np.median(size[~touched])
    return (
        f"steps with contact {touched.mean():.3f}, mean over episodes "
        f"{np.mean([one.touched.mean() for one in episodes]):.3f}, episodes touched "
        f"{len(first) / len(episodes):.2f} (first at step {np.median(first):.0f}), with both "
        f"fingers {np.mean([one.both.sum() for one in episodes]):.2f} steps an episode, "
        f"force in contact {above:.1f} N above free air, "
        f"variance {np.mean([one.forces.var(axis=0).mean() for one in episodes]):.0f} N^2"
    )


@dataclass
class RandomPlay:
    """What random actions meet in one task."""

    ticks: int = 0
    table_ticks: int = 0
    clipped_steps: int = 0
    deepest: float = 0.0
    touch_ticks: int = 0
    successes: int = 0
    discovered: int = 0


def deepest(environment: MiniTouchEnv) -> float:
    """Return the deepest penetration (m) of the arm or the object, in any body but the base's."""
    client, bodies = (
        environment.client._bullet.id,
        (environment.arm.body, environment.task.target_body),
    )
    points = [
        point
        for body in bodies
        for other in range(pybullet.getNumBodies(physicsClientId=client))
        if other != body
        for point in pybullet.getClosestPoints(body, other, 0.0, physicsClientId=client)
        if not (body == environment.arm.body and point[3] < 0)
        and not (body != environment.arm.body and other == environment.arm.body)
    ]
    if environment.task.spec.name == "opening":  # the cabinet's floor stands on the table
        points = [point for point in points if environment.arm.body in point[1:3]]
    return -min((point[8] for point in points), default=0.0)


def look_at_resets(environment: MiniTouchEnv, count: int) -> str:
    """Reset often and say what is seen and what overlaps."""
    pixels, contrasts, depths = [], [], []
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        observation, _ = environment.reset(seed=seed)
        seen, image = environment._camera.visible_bodies(environment.client), observation["image"]
        pixels.append(min((seen == body).sum() for body in environment.task.visible_bodies))
        shown = seen == environment.task.target_body
        table = image[0][seen == TABLE]
        contrasts.append(abs(float(image[0][shown].mean()) - float(np.median(table))))
        depths.append(deepest(environment))
    few = np.mean(np.array(pixels) < PROTOCOL.observation.least_visible_pixels)
    return (
        f"{count} resets: below 15 pixels {few:.1%}, "
        f"median {np.median(pixels):.0f}, least {min(pixels)}; "
        f"below 50 gray levels {np.mean(np.array(contrasts) < 50):.1%} "
        f"(median {np.median(contrasts):.0f}), deepest overlap {1000 * max(depths):.2f} mm"
    )


def play(environment: MiniTouchEnv, count: int) -> str:
    """Play random episodes and say what happened."""
    found, client = RandomPlay(), environment.client
    limit = environment.task.spec.force_limit
    step_client = client.step
    episodes: list[Felt] = []
    with_both: set[bool] = set()

    def step_and_look() -> None:
        step_client()
        found.ticks += 1
        touching = {
            contact.link_a
            for contact in client.contacts(environment.arm.body, environment.task.target_body)
            if contact.normal_force > 0 and contact.link_b in environment.task.target_links
        }
        if touching.issuperset(FINGERS):
            with_both.add(True)
        found.table_ticks += any(
            contact.link_a >= 0 and contact.normal_force > 0
            for contact in client.contacts(environment.arm.body, TABLE)
        )

    client.step = step_and_look
    for seed in range(FIRST_SEED, FIRST_SEED + count):
        environment.reset(seed=seed)
        rng, ended, angle = np.random.default_rng(seed), False, 0.0
        forces, touched, both = [], [], []
        while not ended:
            action = rng.uniform(-1.0, 1.0, environment.action_space.shape).astype(np.float32)
            observation, _, terminated, truncated, info = environment.step(action)
            ended = terminated or truncated
            forces.append(observation["touch"][FORCES])
            touched.append(info["contact_ticks"] > 0)
            both.append(bool(with_both))
            with_both.clear()
            found.clipped_steps += bool((np.abs(forces[-1]) >= limit).any())
            found.touch_ticks += int(info["contact_ticks"])
            angle = max(angle, float(info["object_state"][0]))
            for finger in FINGERS:
                points = pybullet.getContactPoints(
                    environment.arm.body,
                    environment.task.target_body,
                    linkIndexA=finger,
                    physicsClientId=client._bullet.id,
                )
                found.deepest = max(found.deepest, *(-point[8] for point in points), 0.0)
        episodes.append(Felt(np.array(forces), np.array(touched), np.array(both)))
        found.successes += bool(info["success"])
        found.discovered += angle > DISCOVERED_RAD
    opening = environment.task.spec.name == "opening"
    return (
        f"{count} random episodes: on the table {found.table_ticks / found.ticks:.2%} of ticks, "
        f"clipped force {found.clipped_steps / count:.1f} steps an episode, "
        f"deepest finger {1000 * found.deepest:.1f} mm, "
        f"touch {found.touch_ticks / count:.0f} ticks, success {found.successes / count:.3f}, "
        + felt_in_words(episodes)
        + (f", door beyond 5 degrees {found.discovered / count:.2f}" if opening else "")
    )


def look(task: str, episodes: int, resets: int) -> str:
    """Return the lines of one task."""
    environment = MiniTouchEnv(task)
    lines = [look_at_resets(environment, resets), play(environment, episodes)]
    environment.close()
    return "\n".join(f"{task}: {line}" for line in lines)


if __name__ == "__main__":
    given = [int(text) for text in sys.argv[1:] if text.isdigit()]
    tasks = [text for text in sys.argv[1:] if not text.isdigit()] or TASK_NAMES
    episodes, resets = (*given, *(50, 500)[len(given) :])
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        for lines in pool.starmap(look, [(task, episodes, resets) for task in tasks]):
            print(lines, flush=True)
