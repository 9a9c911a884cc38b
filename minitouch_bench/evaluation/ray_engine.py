"""Episodes as tasks of a Ray cluster, which finds room for them and repeats what a dead worker did.

The cluster is one that is there, or one started on this machine for the length of a run.
"""

import contextlib
import logging
import os
import re
import secrets
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import ModuleType
from typing import Any

from minitouch_bench.episode import IN_MEMORY, EpisodeSpec, PlayedEpisode
from minitouch_bench.errors import InfrastructureError, OutOfMemoryError, UsageError
from minitouch_bench.evaluation.engine import Engine
from minitouch_bench.evaluation.execution import package_versions
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.evaluation.rollout import EpisodeRunner, PolicyMaker
from minitouch_bench.machine import compare_versions, require
from minitouch_bench.policies.policy import PolicySource
from minitouch_bench.policies.sources import read_again
from minitouch_bench.processes import ARITHMETIC, MAX_ATTEMPTS, core_count, interrupts_held
from minitouch_bench.protocol.minitouch import PROTOCOL
from minitouch_bench.text import plain_line

ANSWER_S = 20.0
"""Time for Ray's own check of an address, in s; it must import Ray."""

LOCAL = "local"
"""Ray's word for a cluster that it starts on this machine."""

RAY_VARIABLES = {
    "RAY_USAGE_STATS_ENABLED": "0",  # Ray reports its use to its makers otherwise
    "RAY_gcs_server_request_timeout_seconds": "10",  # 60 otherwise: what does not answer hangs
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # a warning for users of GPUs
}
"""Environment of Ray, which reads it when it is imported; what the user has set goes first."""


def open_ray(workers: int | None, address: str | None) -> contextlib.AbstractContextManager[Engine]:
    """Open an engine on a Ray cluster, by default one of ``workers`` CPUs that is started here.

    Raises:
        UsageError: the address is not HOST:PORT, the path of this Python contains a space, or this
            process uses Ray already.
    """
    if " " in sys.executable:  # Ray starts no worker that has variables of its own, and waits
        raise UsageError(
            f"Ray cannot start '{sys.executable}': its path contains a space.\n"
            "Use --engine local, or an environment in another directory"
        )
    if address is not None and not re.fullmatch(r"[^/]+:\d{1,5}", address):
        raise UsageError(
            f"--address is HOST:PORT of the cluster's head, as in 10.0.0.1:6379, not '{address}'"
        )
    return _connected(workers, address)


@contextlib.contextmanager
def _connected(workers: int | None, address: str | None) -> Iterator[Engine]:
    for name, value in RAY_VARIABLES.items():
        os.environ.setdefault(name, value)
    if not address and "ray" not in sys.modules and "RAY_AUTH_MODE" not in os.environ:
        # A Ray started here takes orders from nobody else.
        os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}
    ray = require("ray", "ray")
    if ray.is_initialized():
        raise UsageError(
            "this process uses Ray already, and a run ends its Ray: use another process"
        )
    with tempfile.TemporaryDirectory(prefix="ray-", ignore_cleanup_errors=True) as folder:
        if address is not None:
            _check_cluster(address)
            settings: dict[str, Any] = {"address": address}
        else:
            cpus = workers or core_count()
            settings = {"address": LOCAL, "num_cpus": cpus, "num_gpus": 0, "_temp_dir": folder}
            settings["include_dashboard"] = False
        try:
            with interrupts_held():  # a Ray that is broken off while it starts or ends may crash
                _init(ray, settings)
            yield RayEngine(ray, workers)
        finally:
            with interrupts_held():
                ray.shutdown(wait_for_processes=True)


def _check_cluster(address: str) -> None:
    """Make sure that a Ray cluster answers: Ray itself tries forever where another server does."""
    command = (sys.executable, "-m", "ray.scripts.scripts", "health-check", "--address", address)
    try:  # versions are compared when we join, which says what differs
        subprocess.run(
            (*command, "--skip-version-check"), check=True, capture_output=True, timeout=ANSWER_S
        )
    except (subprocess.TimeoutExpired, subprocess.CalledProcessError) as error:
        raise InfrastructureError(f"no Ray cluster answers at {address}") from error


def _init(ray: ModuleType, settings: dict[str, Any]) -> None:
    try:
        ray.init(**settings, log_to_driver=False, logging_level=logging.CRITICAL)
    except Exception as error:  # some of Ray's have no class of their own
        reason = plain_line(str(error.__cause__ or error).strip().partition("\n")[0])
        advice = "This machine must be one of its nodes: ray start --address=HOST:PORT --num-cpus=0"
        if settings["address"] == LOCAL:
            advice = "Use --engine local"
            if "AF_UNIX" in reason:
                advice = f"Set TMPDIR to a shorter path than {tempfile.gettempdir()}, such as /tmp"
        where = f"the Ray cluster ({settings['address']})"
        text = f"{where} cannot be started or joined: {reason}.\n{advice}"
        raise InfrastructureError(text) from error


class RayEngine:
    """Runs each episode as a task that has one CPU of the cluster.

    ``ray`` is the module, connected to a cluster. At most ``limit`` tasks run at a time, by default
    one for each CPU that the cluster has at the moment.
    """

    def __init__(self, ray: ModuleType, limit: int | None) -> None:
        self._ray = ray
        self._limit = limit

    @property
    def workers(self) -> int:
        """How many episodes the cluster as it is can run at a time."""
        cpus = int(self._ray.cluster_resources().get("CPU", 0))
        return max(1, cpus if self._limit is None else min(cpus, self._limit))

    def run(self, source: PolicyMaker, specs: Sequence[EpisodeSpec]) -> Iterator[PlayedEpisode]:
        """Yield records as episodes end; Ray repeats what a lost worker was doing elsewhere.

        Raises:
            InfrastructureError: an episode failed three times for no fault of the policy, or a
                node has other versions than this machine.
        """
        play = self._ray.remote(play_episode).options(
            num_cpus=1,
            max_retries=MAX_ATTEMPTS - 1,
            retry_exceptions=[InfrastructureError],
            # Numeric libraries read these when they are loaded, before the process's first line.
            runtime_env={"env_vars": ARITHMETIC},
        )
        packed, facts = self._ray.put(pack_source(source)), facts_of_this_machine()
        waiting, running = deque(specs), dict[Any, EpisodeSpec]()
        try:
            while waiting or running:
                for _ in range(min(len(waiting), self.workers - len(running))):
                    spec = waiting.popleft()
                    running[play.remote([packed], facts, spec)] = spec
                (ended, *_), _ = self._ray.wait([*running])
                yield self._result(ended, running.pop(ended))
        finally:
            for reference in running:
                self._ray.cancel(reference, force=True)

    def _result(self, reference: Any, spec: EpisodeSpec) -> PlayedEpisode:
        try:
            record: PlayedEpisode = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            lost = f"its worker was lost three times ({type(error).__name__})"
            reason = plain_line(str(getattr(error, "cause", "") or lost).strip())
            raise InfrastructureError(f"episode {spec.key} cannot be played: {reason}") from error
        return record


def facts_of_this_machine() -> dict[str, str]:
    """Return what an episode's bits depend on beside the episode and the policy."""
    return {**package_versions(), "protocol": PROTOCOL.digest()[:12]}


def pack_source(source: PolicyMaker) -> PolicyMaker:
    """Return what makes the policies from the bytes of its checkpoints; a recording has none.

    Raises:
        CheckpointChangedError: one cannot be read, or is no longer what it was.
    """

    def packed(policy: PolicySource) -> PolicySource:
        if policy.parts:
            return replace(policy, parts=tuple((task, packed(part)) for task, part in policy.parts))
        if not policy.digest or policy.kind == IN_MEMORY:
            return policy
        return replace(policy, content=read_again(policy.target, policy.digest))

    if not isinstance(source, PolicySetup):
        return source
    explorer = source.exploration and packed(source.exploration)
    return replace(source, policy=packed(source.policy), exploration=explorer)


# What runs on a node


_runners: dict[Any, EpisodeRunner] = {}
"""What plays episodes in this process, by the reference of its policy maker; one at a time."""


def play_episode(packed: list[Any], asked: Mapping[str, str], spec: EpisodeSpec) -> PlayedEpisode:
    """Play an episode in this process.

    Args:
        packed: A reference to the policy maker. Ray does not read what is in a list, so the
            source is read once and not with each episode.
        asked: The facts of the machine that asks.
        spec: The episode.

    Raises:
        UsageError: this machine has other versions than the one that asks.
        InfrastructureError: an error of this machine.
    """
    ray = require("ray", "ray")
    node, (reference,) = ray.util.get_node_ip_address(), packed
    if differences := compare_versions(facts_of_this_machine(), asked):
        raise UsageError(f"node {node} has other versions: {differences}")
    try:
        if reference not in _runners:
            _close_runners()
            _runners[reference] = EpisodeRunner(ray.get(reference))
        return _runners[reference].run(spec)
    except OutOfMemoryError as error:
        raise OutOfMemoryError(f"episode {spec.key}: {error} (on node {node})") from error
    except Exception as error:
        _close_runners()
        raise InfrastructureError(f"{type(error).__name__}: {error} (on node {node})") from error


def _close_runners() -> None:
    while _runners:
        _, runner = _runners.popitem()
        with contextlib.suppress(Exception):
            runner.close()
