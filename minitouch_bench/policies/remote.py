"""A policy behind HTTP: the client of the small protocol that ``server`` speaks."""

import http.client
import json
import urllib.parse
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.errors import PolicyFaultError, PolicyLoadError
from minitouch_bench.policies.policy import Checkpoint, Observation
from minitouch_bench.policies.wire import describe, pack_observation, plain_line

PROTOCOL = 1
MAX_ANSWER = 64 * 1024
SOCKET_TIMEOUT_S = 300.0
"""Only a backstop: the deadline of an act is kept by the process that asked for it."""


class RemotePolicy:
    """Send every observation to a policy server over one lasting connection."""

    def __init__(self, url: str, deterministic: bool) -> None:
        parts = urllib.parse.urlsplit(url)
        secure = parts.scheme == "https"
        connect = http.client.HTTPSConnection if secure else http.client.HTTPConnection
        self._connection = connect(parts.netloc, timeout=SOCKET_TIMEOUT_S)
        self._prefix = parts.path.rstrip("/")
        self._deterministic = deterministic
        self._episode = ""

    def info(self) -> dict[str, Any]:
        """Return the server's ``protocol`` and ``name``."""
        return self._call("GET", "/info")

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode on the server and end the one before."""
        self._end()
        question = {"seed": seed, "task": task, "deterministic": self._deterministic}
        answer = self._call("POST", "/episodes", json.dumps(question).encode())
        episode = answer.get("episode")
        if not isinstance(episode, str | int):
            raise PolicyFaultError("the policy server's answer has no 'episode'")
        self._episode = urllib.parse.quote(str(episode), safe="")

    def act(self, observation: Observation) -> NDArray[np.float64]:
        """Return the server's action; JSON knows one kind of number, so 0 counts as 0.0."""
        path = f"/episodes/{self._episode}/act"
        action = self._call("POST", path, pack_observation(observation)).get("action")
        if not isinstance(action, list) or not all(type(x) in (int, float) for x in action):
            raise PolicyFaultError("the policy server's answer has no list of numbers 'action'")
        return np.array([float(x) for x in action], np.float64)

    def close(self) -> None:
        """End the episode on the server and the connection to it."""
        self._end()
        self._connection.close()

    def _end(self) -> None:
        if self._episode:
            self._call("DELETE", f"/episodes/{self._episode}")
            self._episode = ""

    def _call(self, method: str, path: str, body: bytes | None = None) -> dict[str, Any]:
        kind = "application/octet-stream" if path.endswith("/act") else "application/json"
        self._connection.request(method, self._prefix + path, body, {"Content-Type": kind})
        response = self._connection.getresponse()
        content = response.read(MAX_ANSWER + 1)
        if len(content) > MAX_ANSWER:
            raise PolicyFaultError("the policy server's answer is longer than 64 KiB")
        try:
            answer = json.loads(content)
        except (ValueError, RecursionError):
            answer = None
        if response.status != http.HTTPStatus.OK or not isinstance(answer, dict):
            problem = answer.get("error", "") if isinstance(answer, dict) else "no JSON object"
            raise PolicyFaultError(
                plain_line(f"the policy server answered {response.status} to {path}: {problem}")
            )
        return answer


def load_remote(checkpoint: Checkpoint) -> RemotePolicy:
    """Connect to a policy server.

    Raises:
        PolicyLoadError: nobody answers, or in another protocol.
    """
    policy = RemotePolicy(checkpoint.target, checkpoint.deterministic)
    try:
        info = policy.info()
    except (OSError, ValueError, http.client.HTTPException, PolicyFaultError) as error:
        raise PolicyLoadError(
            f"no policy server at {checkpoint.target} ({describe(error)})"
        ) from error
    if info.get("protocol") != PROTOCOL:
        raise PolicyLoadError(f"{checkpoint.target} does not speak protocol {PROTOCOL}")
    return policy
