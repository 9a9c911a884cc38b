"""Serve a policy over HTTP, for policies that cannot run on the evaluating machine.

::

    GET    /info              -> {"protocol": 1, "name": "..."}
    POST   /episodes          {"seed": 7, "task": "pushing", "deterministic": true}
                              -> {"episode": "ID"}
    POST   /episodes/ID/act   7056 image bytes, then 11 little-endian float32
                              -> {"action": [dx, dy, dz, finger]}
    DELETE /episodes/ID       -> {}

An error answers with another status than 200 and {"error": "one line"}.
"""

import itertools
import json
import threading
from collections import OrderedDict
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np

from minitouch_bench.policies.factory import make_policy
from minitouch_bench.policies.policy import Policy, close_policy
from minitouch_bench.policies.remote import PROTOCOL
from minitouch_bench.policies.wire import (
    OBSERVATION_BYTES,
    WireError,
    describe,
    unpack_observation,
)

MAX_EPISODES = 1024
"""Episodes kept open; beyond it the oldest is dropped, its evaluation having died."""


class RequestError(Exception):
    """A request that gets another status than 200."""

    def __init__(self, status: HTTPStatus, text: str) -> None:
        super().__init__(text)
        self.status = status


class PolicyServer(ThreadingHTTPServer):
    """An HTTP server with one policy an episode, so that evaluating workers do not mix."""

    daemon_threads = True

    def __init__(
        self, factory: Callable[..., Policy], address: tuple[str, int], name: str = "policy"
    ) -> None:
        super().__init__(address, PolicyHandler)
        self.name = name
        self._factory = factory
        self._numbers = itertools.count(1)
        self._episodes: OrderedDict[str, Policy] = OrderedDict()
        self._lock = threading.Lock()

    def begin(self, body: bytes) -> str:
        """Make and reset the policy of a new episode and return the episode's id."""
        try:
            question = json.loads(body)
            seed, task = int(question["seed"]), str(question["task"])
            deterministic = bool(question.get("deterministic", True))
        except (KeyError, ValueError, TypeError) as error:
            raise RequestError(HTTPStatus.BAD_REQUEST, describe(error)) from error
        policy = make_policy(self._factory, deterministic)
        policy.reset(seed, task)
        with self._lock:
            episode = str(next(self._numbers))
            self._episodes[episode] = policy
            oldest = None
            if len(self._episodes) > MAX_EPISODES:
                _, oldest = self._episodes.popitem(last=False)
        close_policy(oldest)
        return episode

    def act(self, episode: str, body: bytes) -> list[float]:
        """Return the action of an episode's policy."""
        policy = self._episodes.get(episode)
        if policy is None:
            raise RequestError(HTTPStatus.NOT_FOUND, f"no episode {episode}")
        action = np.asarray(policy.act(unpack_observation(body)), np.float64)
        return [float(number) for number in action.reshape(-1)]

    def end(self, episode: str) -> dict[str, Any]:
        """Forget an episode; one that is not there is forgotten already."""
        with self._lock:
            ended = self._episodes.pop(episode, None)
        close_policy(ended)
        return {}


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
            answer = self._answer(self._body())
        except RequestError as error:
            status, answer = error.status, {"error": str(error)}
        except WireError as error:
            status, answer = HTTPStatus.BAD_REQUEST, {"error": describe(error)}
        except Exception as error:  # the policy's own failure is for the evaluation to show
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
        if not (length.isdecimal() and int(length) <= OBSERVATION_BYTES):
            self.close_connection = True  # the body stays unread
            raise RequestError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a body of {length} bytes")
        return self.rfile.read(int(length))

    def _answer(self, body: bytes) -> dict[str, Any]:
        match self.command, self.path.split("/")[1:]:
            case "GET", ["info"]:
                return {"protocol": PROTOCOL, "name": self.server.name}
            case "POST", ["episodes"]:
                return {"episode": self.server.begin(body)}
            case "POST", ["episodes", episode, "act"]:
                return {"action": self.server.act(episode, body)}
            case "DELETE", ["episodes", episode]:
                return self.server.end(episode)
        raise RequestError(HTTPStatus.NOT_FOUND, f"no {self.command} {self.path}")


def serve(factory: Callable[..., Policy], host: str = "127.0.0.1", port: int = 8000) -> None:
    """Serve policies until interrupted, each episode with a new one from ``factory``."""
    with PolicyServer(factory, (host, port), getattr(factory, "__name__", "policy")) as server:
        server.serve_forever()
