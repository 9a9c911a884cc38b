"""The command ``record``: a policy's episodes as a dataset in Minari's format."""

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from minitouch_bench.cli import options
from minitouch_bench.cli.console import episode_progress, note
from minitouch_bench.episode import Outcome, PlayedEpisode
from minitouch_bench.errors import PolicyFaultError, RunDirectoryError, UsageError
from minitouch_bench.files import os_errors_as
from minitouch_bench.machine import require
from minitouch_bench.policies.policy import Isolation, isolation_options
from minitouch_bench.protocol.minitouch import PROTOCOL

if TYPE_CHECKING:
    from minitouch_bench.tasks.environment import MiniTouchEnv

RECORDING_SUITE = "recording"
"""Seeds recorded episodes; no suite has this name."""


def record(
    policy: options.Policy,
    task: options.Task,
    *,
    output: Annotated[
        Path, typer.Option(metavar="DIR", help="Directory of the dataset; it must not exist.")
    ],
    episodes: Annotated[
        int, typer.Option(metavar="N", min=1, help="Number of episodes to record.")
    ] = 100,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Seed of the episodes.")] = 0,
    isolation: options.IsolationLevel = Isolation.SANDBOX.value,
    trust: options.Trust = False,
) -> None:
    """Record a policy's episodes in Minari's format, for train --from-log and other libraries.

    An episode with a fault ends as truncated. The directory appears when the dataset is complete.
    """
    from minitouch_bench.evaluation.actors import prepare_policies
    from minitouch_bench.evaluation.rollout import EpisodeRunner
    from minitouch_bench.protocol.minitouch import PUBLIC_SEED_BITS
    from minitouch_bench.protocol.spec import SuiteSpec
    from minitouch_bench.runs.plan import Plan, suite_episodes
    from minitouch_bench.tasks.environment import MiniTouchEnv

    if seed.bit_length() > PUBLIC_SEED_BITS:  # the episodes' seeds then have 128
        raise UsageError(f"--seed is below 2^{PUBLIC_SEED_BITS} in a dataset, not {seed}")
    isolated = isolation_options(isolation, trust)
    tasks = (PROTOCOL.task(task).name,)
    suite = SuiteSpec(RECORDING_SUITE, tasks, episodes, rankable=False, seed=seed)
    plan = Plan(suite.name, tasks, episodes, seed, limits=isolated.limits)
    minari = require("minari", "data")
    storages = require("minari.dataset.minari_storage", "data")
    setup = prepare_policies(policy, plan, isolated, note)
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", setup.policy.name).strip("-") or "policy"
    faults = 0
    with (
        episode_progress() as callbacks,
        _new_directory(output) as folder,
        contextlib.closing(MiniTouchEnv(task)) as environment,
        contextlib.closing(EpisodeRunner(setup)) as runner,
    ):
        storage = storages.MinariStorage.new(
            folder,
            environment.observation_space,
            environment.action_space,
            jpeg_encoding=False,  # pictures as they are
        )
        callbacks.phase("recording", episodes)
        for spec in suite_episodes(suite):
            played = runner.run(spec)
            if len(played.trace.actions):  # none where the policy failed at the reset
                storage.update_episodes([_episode(environment, played)])
            callbacks.episode(played)
            faults += played.outcome is Outcome.POLICY_FAULT
        storage.update_metadata(
            {
                "dataset_id": f"minitouch/{task}/{name}-v0",
                "minari_version": minari.__version__,
                "algorithm_name": setup.policy.name,
            }
        )
    print(output)
    if faults:
        note(f"{faults} of {episodes} episodes end with a fault of the policy")
        raise typer.Exit(PolicyFaultError.exit_code)


@contextlib.contextmanager
def _new_directory(directory: Path) -> Iterator[Path]:
    """Give a path beside a new directory; what is written there becomes it when the block ends.

    Raises:
        RunDirectoryError: the directory is there already, or cannot be written.
    """
    if directory.exists():
        raise RunDirectoryError(f"{directory} is there already; choose another --output")
    with os_errors_as(RunDirectoryError, directory, "written"):
        directory.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=f".{directory.name}-", dir=directory.parent) as folder:
            # Minari joins a relative path to itself.
            unfinished = Path(folder).absolute() / directory.name
            yield unfinished
            unfinished.rename(directory)


def _episode(environment: "MiniTouchEnv", played: PlayedEpisode) -> Any:
    """Return an episode with its pictures: its actions done again give the same bits."""
    import numpy as np

    from minitouch_bench.tasks.environment import OBJECT

    buffers = require("minari.data_collector.episode_buffer", "data")
    spec, trace = played.spec, played.trace
    images = [environment.reset(seed=spec.seed, options={OBJECT: spec.shape})[0]["image"]]
    images += [environment.step(action)[0]["image"] for action in trace.actions]
    last = np.arange(len(trace.actions)) == len(trace.actions) - 1
    terminated = last & (played.outcome in (Outcome.SUCCESS, Outcome.LEFT_WORKSPACE))
    success = last & (played.outcome is Outcome.SUCCESS)
    return buffers.EpisodeBuffer(
        seed=spec.seed,
        observations={"image": np.stack(images), "touch": trace.touch},
        actions=trace.actions,
        rewards=trace.rewards.tolist(),
        terminations=terminated.tolist(),
        truncations=(last & ~terminated).tolist(),
        infos={"is_success": np.concatenate(([False], success))},
    )
