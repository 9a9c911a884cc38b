"""A policy behind HTTP, which cannot run on the evaluating machine: its server, and the client.

::

    GET    /info              -> {"protocol": 1, "name": "..."}
    POST   /episodes          {"seed": 7, "task": "pushing", "deterministic": true}
                              -> {"episode": "ID"}
    POST   /episodes/ID/act   7056 image bytes, then 11 little-endian float32
                              -> {"action": [dx, dy, dz, finger]}
    DELETE /episodes/ID       -> {}

An error answers with another status than 200 and {"error": "one line"}.
"""

import http.client
import itertools
import json
import select
import sys
import threading
import urllib.parse
from collections import OrderedDict
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.episode import Observation
from minitouch_bench.errors import PolicyFaultError, PolicyLoadError, ServerUnreachableError
from minitouch_bench.policies import wire
from minitouch_bench.policies.policy import Policy, PolicySource, begin_episode, close_policy
from minitouch_bench.policies.python_objects import make_policy
from minitouch_bench.protocol.limits import MAX_TIMEOUT_S
from minitouch_bench.text import describe, plain_line

MAX_OPEN_EPISODES = 1024
"""Episodes kept open; beyond it the oldest is dropped, its evaluation having died."""


class PolicyServer(ThreadingHTTPServer):
    """An HTTP server with one policy an episode, so that evaluating workers do not mix."""

    daemon_threads = True

    def __init__(self, factory: Callable[..., Policy], address: tuple[str, int]) -> None:
        super().__init__(address, PolicyHandler)
        self.name = getattr(factory, "__name__", "policy")
        self._factory = factory
        self._numbers = itertools.count(1)
        self._episodes: OrderedDict[str, Policy] = OrderedDict()
        self._lock = threading.Lock()

    def begin(self, body: bytes) -> str:
        """Make and reset the policy of a new episode and return the episode's id."""
        question = json.loads(body)
        policy = make_policy(self._factory, bool(question.get("deterministic", True)))
        begin_episode(policy, int(question["seed"]), str(question["task"]))
        with self._lock:
            episode = str(next(self._numbers))
            self._episodes[episode] = policy
            oldest = None
            if len(self._episodes) > MAX_OPEN_EPISODES:
                _, oldest = self._episodes.popitem(last=False)
        close_policy(oldest)
        return episode

    def act(self, episode: str, body: bytes) -> list[float]:
        """Return the action of an episode's policy."""
        policy = self._episodes.get(episode)
        if policy is None:
            raise wire.WireError(f"no episode {episode}")
        action = np.asarray(policy.act(wire.unpack_observation(body)), np.float64)
        return [float(number) for number in action.reshape(-1)]

    def end(self, episode: str) -> dict[str, Any]:
        """Forget an episode; one that is not there is forgotten already."""
        with self._lock:
            ended = self._episodes.pop(episode, None)
        close_policy(ended)
        return {}

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Pass over a client that is gone: an evaluation ends its processes at once."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class PolicyHandler(BaseHTTPRequestHandler):
    """Answer the requests of one connection."""

    server: PolicyServer
    protocol_version = "HTTP/1.1"
    server_version = "minitouch-policy"
    wbufsize = -1  # headers and body leave in one packet
    disable_nagle_algorithm = True

    def log_message(self, *_: Any) -> None:
        """Stay silent: a line an act would be thousands."""

    def do_GET(self) -> None:
        """Answer a request."""
        status = HTTPStatus.OK
        try:
            if "Origin" in self.headers:
                self.close_connection = True  # its body is not read
                raise wire.WireError("a web page may not ask a policy")
            answer = self._answer(self._body())
        except wire.WireError as error:
            status, answer = HTTPStatus.BAD_REQUEST, {"error": str(error)}
        except BaseException as error:  # the policy's own failure is for the evaluation to show
            status, answer = HTTPStatus.INTERNAL_SERVER_ERROR, {"error": describe(error)}
        content = json.dumps(answer).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    do_POST = do_DELETE = do_GET  # noqa: N815  the names that http.server calls

    def _body(self) -> bytes:
        length = self.headers.get("Content-Length") or "0"
        if not (length.isdecimal() and int(length) <= wire.OBSERVATION_BYTES):
            self.close_connection = True  # the body stays unread
            raise wire.WireError(f"a body of {length} bytes")
        return self.rfile.read(int(length))

    def _answer(self, body: bytes) -> dict[str, Any]:
        match self.command, self.path.split("/")[1:]:
            case "GET", ["info"]:
                return {"protocol": HTTP_API_VERSION, "name": self.server.name}
            case "POST", ["episodes"]:
                return {"episode": self.server.begin(body)}
            case "POST", ["episodes", episode, "act"]:
                return {"action": self.server.act(episode, body)}
            case "DELETE", ["episodes", episode]:
                return self.server.end(episode)
        raise wire.WireError(f"no {self.command} {self.path}")


def serve(factory: Callable[..., Policy], host: str = "127.0.0.1", port: int = 8000) -> None:
    """Serve policies until interrupted, each episode with a new one from ``factory``."""
    with PolicyServer(factory, (host, port)) as server:
        server.serve_forever()


HTTP_API_VERSION = 1
MAX_ANSWER = 64 * 1024
CONNECT_TIMEOUT_S = 2.0
SOCKET_TIMEOUT_S = MAX_TIMEOUT_S
"""Only a backstop: the deadline of an act is kept by the process that asked for it."""


class RemotePolicy:
    """Send every observation to a policy server over one lasting connection.

    Each request raises ``ServerUnreachableError`` where there is no connection to send it over.
    """

    def __init__(self, url: str, deterministic: bool) -> None:
        parts = urllib.parse.urlsplit(url)
        secure = parts.scheme == "https"
        connect = http.client.HTTPSConnection if secure else http.client.HTTPConnection
        self._connection = connect(parts.netloc, timeout=CONNECT_TIMEOUT_S)
        self._url, self._prefix = url, parts.path.rstrip("/")
        self._deterministic = deterministic
        self._episode = ""

    def reset(self, seed: int, task: str) -> None:
        """Begin an episode on the server, the only one of this object."""
        question = {"seed": seed, "task": task, "deterministic": self._deterministic}
        answer = self.call("POST", "/episodes", json.dumps(question).encode())
        episode = answer.get("episode")
        if not isinstance(episode, str | int):
            raise PolicyFaultError("the policy server's answer has no 'episode'")
        self._episode = urllib.parse.quote(str(episode), safe="")

    def act(self, observation: Observation) -> NDArray[np.float64]:
        """Return the server's action; JSON knows one kind of number, so 0 counts as 0.0."""
        path = f"/episodes/{self._episode}/act"
        action = self.call("POST", path, wire.pack_observation(observation)).get("action")
        if not isinstance(action, list) or not all(type(x) in (int, float) for x in action):
            raise PolicyFaultError("the policy server's answer has no list of numbers 'action'")
        return np.array([float(x) for x in action], np.float64)

    def close(self) -> None:
        """End the episode on the server and the connection to it."""
        if self._episode:
            self.call("DELETE", f"/episodes/{self._episode}")
        self._connection.close()

    def _connect(self) -> None:
        """Connect, again if the server has closed the connection, as after a pause."""
        if self._connection.sock is not None:
            unasked = select.poll()
            unasked.register(self._connection.sock, select.POLLIN)
            if not unasked.poll(0):
                return
            self._connection.close()
        try:
            self._connection.connect()
        except OSError as error:
            self._connection.close()
            raise ServerUnreachableError(
                f"the policy server {self._url} cannot be reached ({describe(error)})"
            ) from error
        self._connection.sock.settimeout(SOCKET_TIMEOUT_S)

    def call(self, method: str, path: str, body: bytes | None = None) -> dict[str, Any]:
        """Return the server's answer to a request."""
        kind = "application/octet-stream" if path.endswith("/act") else "application/json"
        self._connect()
        try:
            self._connection.request(method, self._prefix + path, body, {"Content-Type": kind})
            response = self._connection.getresponse()
            content = response.read(MAX_ANSWER + 1)
            if len(content) > MAX_ANSWER:
                raise PolicyFaultError("the policy server's answer is longer than 64 KiB")
        except Exception:
            self._connection.close()  # the next request opens it again
            raise
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


def load_remote(source: PolicySource) -> RemotePolicy:
    """Connect to a policy server.

    Raises:
        ServerUnreachableError: nobody is there.
        PolicyLoadError: nobody answers, or in another protocol.
    """
    policy = RemotePolicy(source.target, source.deterministic)
    try:
        info = policy.call("GET", "/info")
    except (OSError, ValueError, http.client.HTTPException, PolicyFaultError) as error:
        raise PolicyLoadError(f"no policy server answers ({describe(error)})") from error
    if info.get("protocol") != HTTP_API_VERSION:
        raise PolicyLoadError(f"it does not speak protocol {HTTP_API_VERSION}")
    return policy
