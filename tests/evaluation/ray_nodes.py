"""Nodes of a Ray cluster on this machine, each a process group of its own that can be killed."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.evaluation.engine import Engine, open_engine
from minitouch_bench.evaluation.ray_engine import RAY_VARIABLES

START = (sys.executable, "-m", "ray.scripts.scripts", "start", "--block")
QUICK = {"RAY_health_check_period_ms": "500", "RAY_health_check_timeout_ms": "2000"}
"""A head then finds that a node is lost within seconds, not a quarter of a minute."""

QUIET = ("--object-store-memory=100000000", "--dashboard-agent-listen-port=0")


class Node:
    """One node, running until it is killed."""

    def __init__(self, *options: str, **variables: str) -> None:
        self.process = subprocess.Popen(
            [*START, *QUIET, *options],
            env={**os.environ, **RAY_VARIABLES, **QUICK, **variables},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def kill(self) -> None:
        """Lose the node at once, with everything on it."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("", 0))
        return int(one.getsockname()[1])


@contextlib.contextmanager
def head() -> Iterator[str]:
    """Run a head and yield the cluster's address."""
    port = free_port()
    folder = tempfile.mkdtemp(prefix="ray-")  # pytest's own are too long for sockets
    options = ("--head", f"--port={port}", "--num-cpus=1", f"--temp-dir={folder}")
    node = Node(*options, "--include-dashboard=false")
    try:
        address = f"127.0.0.1:{port}"
        wait_for_nodes(address, 1)
        yield address
    finally:
        node.kill()
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def joined(address: str, total: int, **variables: str) -> Iterator[Node]:
    """Let a node of one CPU join, which makes so many in all; it has left afterwards."""
    node = Node(f"--address={address}", "--num-cpus=1", **variables)
    try:
        wait_for_nodes(address, total)
        yield node
    finally:
        node.kill()
        wait_for_nodes(address, total - 1)


def wait_for_nodes(address: str, count: int) -> None:
    """Wait until so many nodes are alive; from within a connection, or by making one."""
    ray = sys.modules.get("ray")
    deadline = time.monotonic() + 60.0
    while True:
        assert time.monotonic() < deadline
        if ray is not None and ray.is_initialized():
            if sum(node["Alive"] for node in ray.nodes()) == count:
                return
        else:
            with contextlib.suppress(InfrastructureError), engine_at(address):
                if sum(node["Alive"] for node in sys.modules["ray"].nodes()) == count:
                    return
        time.sleep(0.2)


def engine_at(address: str | None) -> AbstractContextManager[Engine]:
    return open_engine("ray", address=address)
