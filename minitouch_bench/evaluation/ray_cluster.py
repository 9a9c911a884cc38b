"""A Ray cluster for the length of a run: one that is there, or one started on this machine."""

import contextlib
import logging
import os
import secrets
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from types import ModuleType
from typing import Any

from minitouch_bench.errors import InfrastructureError, UsageError
from minitouch_bench.optional import require
from minitouch_bench.processes import core_count, interrupts_held

ANSWER_S = 5.0
"""Time in which the address of a cluster must accept a connection, in s."""

HEALTH_S = 20.0
"""Time for Ray's own check, in s; it must import Ray."""

HEALTH_CHECK = (
    sys.executable, "-m", "ray.scripts.scripts", "health-check", "--skip-version-check",
    "--address",
)  # fmt: skip
"""Versions are compared when we join, which says what differs."""

SETTINGS = {
    "RAY_USAGE_STATS_ENABLED": "0",  # Ray reports its use to its makers otherwise
    "RAY_gcs_server_request_timeout_seconds": "10",  # 60 otherwise: what does not answer hangs
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",  # a warning for users of GPUs
}
"""Environment of Ray, which reads it when it is imported; what the user has set goes first."""


@contextlib.contextmanager
def ray_cluster(address: str | None, workers: int | None = None) -> Iterator[ModuleType]:
    """Connect to a cluster and yield the module ``ray``; disconnect afterwards.

    Without an address a Ray of ``workers`` CPUs, by default one a core, is started here, and
    ended with all its processes and files.

    Raises:
        MissingExtraError: Ray is not installed.
        UsageError: the address is no HOST:PORT.
        InfrastructureError: no cluster answers there, or none can be started.
    """
    if address is not None:
        check_address(address)
    _prepare_environment(local=address is None)
    ray = require("ray", "ray")
    with contextlib.ExitStack() as stack:
        if address is None:
            folder = tempfile.TemporaryDirectory(prefix="ray-", ignore_cleanup_errors=True)
            options = {
                "address": "local",
                "num_cpus": workers or core_count(),
                "num_gpus": 0,
                "include_dashboard": False,
                "_temp_dir": stack.enter_context(folder),
            }
        else:
            _reach(address)
            options = {"address": address}
        stack.callback(_shut_down, ray)
        with interrupts_held():  # a Ray that is broken off while it starts or ends may crash
            _init(ray, options)
        yield ray


def check_address(address: str) -> tuple[str, int]:
    """Return the host and the port of an address.

    Raises:
        UsageError: it is no HOST:PORT.
    """
    host, _, port = address.rpartition(":")
    if not host or "/" in host or not port.isdecimal() or not 0 < int(port) < 2**16:
        raise UsageError(
            f"--address is HOST:PORT of the cluster's head, as in 10.0.0.1:6379, not '{address}'"
        )
    return host.strip("[]"), int(port)


def _prepare_environment(*, local: bool) -> None:
    """Set what Ray reads when it is imported; a Ray started here takes orders from nobody else."""
    for name, value in SETTINGS.items():
        os.environ.setdefault(name, value)
    if local and "ray" not in sys.modules and "RAY_AUTH_MODE" not in os.environ:
        os.environ |= {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32)}


def _reach(address: str) -> None:
    """Make sure that a Ray cluster answers: Ray itself tries forever where another server does.

    Raises:
        InfrastructureError: nobody answers there, or not as Ray does.
    """
    try:
        socket.create_connection(check_address(address), ANSWER_S).close()
    except OSError as error:
        reason = error.strerror or str(error)
        raise InfrastructureError(f"no Ray cluster answers at {address}: {reason}") from error
    try:
        subprocess.run([*HEALTH_CHECK, address], check=True, capture_output=True, timeout=HEALTH_S)
    except (subprocess.TimeoutExpired, subprocess.CalledProcessError) as error:
        raise InfrastructureError(
            f"what answers at {address} is no head of a Ray cluster, or not a healthy one"
        ) from error


def _init(ray: ModuleType, options: dict[str, Any]) -> None:
    try:
        ray.init(**options, log_to_driver=False, logging_level=logging.CRITICAL)
    except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
        address = options["address"]
        reason = str(error.__cause__ or error).strip().partition("\n")[0]
        if address == "local":
            raise InfrastructureError(f"Ray cannot be started here: {reason}") from error
        raise InfrastructureError(
            f"the Ray cluster at {address} cannot be joined: {reason}.\n"
            "This machine must be one of its nodes: ray start --address=HOST:PORT --num-cpus=0"
        ) from error


def _shut_down(ray: ModuleType) -> None:
    with interrupts_held():
        ray.shutdown(wait_for_processes=True)
