import contextlib
import http.client
import json
import select
import sys
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer

import numpy as np
import pytest

from minitouch_bench.errors import PolicyFaultError, PolicyLoadError, ServerUnreachableError
from minitouch_bench.evaluation.policy_setup import try_policy
from minitouch_bench.policies.policy import Isolation, IsolationOptions, PolicySource, load_policy
from minitouch_bench.policies.policy_process import isolate
from minitouch_bench.policies.server import MAX_OPEN_EPISODES, PolicyHandler, PolicyServer
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.policies.wire import OBSERVATION_BYTES, WireError
from tests.policies.recipes import run_recipes


class Echo:
    """Give back the first touch numbers and what the episode was begun with."""

    def __init__(self, deterministic):
        self.deterministic = deterministic

    def reset(self, seed, task):
        if task == "playing":
            raise ValueError("I do not play")
        self.seed, self.calls = seed, 0

    def act(self, observation):
        self.calls += 1
        image, touch = observation["image"], observation["touch"]
        numbers = [touch[0], image.mean(), self.calls, self.seed % 1000]
        return np.array([*numbers, float(self.deterministic)], np.float32)


@contextlib.contextmanager
def serving(server):
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        thread.join()


@pytest.fixture
def server():
    with PolicyServer(Echo, ("127.0.0.1", 0)) as server, serving(server):
        yield server


@pytest.fixture
def connect(url):
    """Make clients, and close them in the end."""
    with contextlib.ExitStack() as stack:

        def make(**options):
            policy = load_policy(PolicySource("remote", "x", url, **options))
            stack.callback(policy.close)
            return policy

        yield make


@pytest.fixture
def url(server):
    return f"http://127.0.0.1:{server.server_address[1]}"


def test_observations_and_actions_survive_the_way_and_episodes_do_not_mix(connect, observation):
    first, second = (connect(deterministic=d) for d in (True, False))
    first.reset(2**64 - 1, "pushing")
    second.reset(2, "pushing")
    seen = [observation["touch"][0], observation["image"].mean()]
    for policy, told in ((first, [1, 615, 1]), (second, [1, 2, 0]), (first, [2, 615, 1])):
        wanted = np.array([*seen, *told], np.float32)
        assert policy.act(observation).tolist() == wanted.tolist()


def test_a_process_ends_its_episodes_on_the_server_also_those_that_fail(
    server, url, observation, monkeypatch
):
    acts = {"division by zero": lambda *_: 1 / 0, "SystemExit": lambda *_: sys.exit()}
    with isolate(parse_source(url)) as policy:
        for seed in (1, 2):
            policy.reset(seed, "pushing")
            assert policy.act(observation)[2:].tolist() == [1.0, seed]
            assert len(server._episodes) == 1
        with pytest.raises(PolicyFaultError, match="I do not play"):
            policy.reset(1, "playing")
        for word, act in acts.items():
            monkeypatch.setattr(Echo, "act", act)
            policy.reset(1, "pushing")
            with pytest.raises(PolicyFaultError, match=word):
                policy.act(observation)
            assert not server._episodes


def test_a_client_that_is_gone_is_passed_over(server, capfd):
    for error in (ConnectionResetError, ValueError):
        try:
            raise error
        except error:
            server.handle_error(None, ("127.0.0.1", 1))
    assert "ConnectionResetError" not in (told := capfd.readouterr().err)
    assert "ValueError" in told


@pytest.mark.parametrize(
    ("method", "path", "body", "status"),
    [
        ("GET", "/", b"", 400),
        ("GET", "/info", b"", 400),  # asked by a web page of somebody else
        ("POST", "/episodes", b"no json", 500),
        ("POST", "/episodes", b'{"seed": 1}', 500),
        ("POST", "/episodes", b'{"seed": 1, "task": "playing"}', 500),  # the policy's own error
        ("POST", "/episodes/99/act", bytes(OBSERVATION_BYTES), 400),
        ("POST", "/episodes/99/act", bytes(OBSERVATION_BYTES + 1), 400),
        ("DELETE", "/episodes/99", b"", 200),
    ],
)
def test_a_request_that_makes_no_sense_gets_an_error(server, method, path, body, status):
    headers = {"Origin": "https://somebody.example"} if path == "/info" else {}
    connection = http.client.HTTPConnection("127.0.0.1", server.server_address[1], timeout=5)
    connection.request(method, path, body, headers)
    response = connection.getresponse()
    assert response.status == status
    assert ("error" in json.loads(response.read())) is (status != 200)
    connection.close()


def test_beyond_the_most_open_episodes_the_oldest_is_dropped(server):
    question = b'{"seed": 1, "task": "pushing"}'
    first, second, *_ = [server.begin(question) for _ in range(MAX_OPEN_EPISODES + 1)]
    assert server.act(second, bytes(OBSERVATION_BYTES))[2] == 1.0
    with pytest.raises(WireError, match="no episode"):
        server.act(first, bytes(OBSERVATION_BYTES))


class Stranger(BaseHTTPRequestHandler):
    """Give the server's ``answers`` by the last part of the address."""

    protocol_version = "HTTP/1.1"
    log_message = print

    def do_GET(self):
        self.rfile.read(int(self.headers.get("Content-Length") or 0))
        last = self.path.rpartition("/")[2]
        self.send_response(200)
        self.send_header("Content-Length", str(len(self.server.answers[last])))
        self.send_header("Connection", "close" if last == "info" else "keep-alive")
        self.end_headers()
        self.wfile.write(self.server.answers[last])

    do_POST = do_DELETE = do_GET  # noqa: N815


USUAL = {"info": b'{"protocol": 1}', "episodes": b'{"episode": 7}', "act": b'{"action": [0, 1.5]}'}
USUAL["7"] = b"{}"  # the episode is ended


@pytest.mark.parametrize(
    ("odd", "error", "word"),
    [
        ({"info": b'{"protocol": 2}'}, PolicyLoadError, "protocol 1"),
        ({"info": b"hello"}, PolicyLoadError, "JSON"),
        ({"episodes": b"{}"}, PolicyFaultError, "'episode'"),
        ({"act": b"{}"}, PolicyFaultError, "'action'"),
        ({"act": b'{"action": [true, false]}'}, PolicyFaultError, "numbers"),
        ({"act": b'{"action": [0, "1"]}'}, PolicyFaultError, "numbers"),
        ({"act": b"[" * 60_000}, PolicyFaultError, "JSON"),
        ({"act": USUAL["act"].ljust(2**17)}, PolicyFaultError, "64 KiB"),
        ({"act": USUAL["act"].ljust(2**16)}, None, ""),
    ],
)
def test_an_odd_answer_of_a_server_is_named(odd, error, word, observation):
    with HTTPServer(("127.0.0.1", 0), Stranger) as server, serving(server):
        server.answers = {**USUAL, **odd}
        url = f"http://127.0.0.1:{server.server_address[1]}"
        with pytest.raises(error, match=word) if error else contextlib.nullcontext():
            policy = load_policy(PolicySource("remote", "x", url))
            with contextlib.closing(policy):
                policy.reset(1, "pushing")
                assert policy.act(observation).tolist() == [0.0, 1.5]


def test_a_connection_that_the_server_closed_is_opened_again(connect, observation, monkeypatch):
    monkeypatch.setattr(PolicyHandler, "timeout", 0.05)
    policy = connect()
    policy.reset(1, "pushing")
    for call in (1, 2, 3):
        assert policy.act(observation)[2] == call
        assert select.select([policy._connection.sock], [], [], 30.0)[0]  # it is closed there


@pytest.mark.parametrize("level", [Isolation.PROCESS, Isolation.NONE])
def test_a_server_that_cannot_be_reached_is_not_the_policy_s_fault(level, observation, monkeypatch):
    monkeypatch.setattr(PolicyHandler, "protocol_version", "HTTP/1.0")  # a connection per request
    with PolicyServer(Echo, ("127.0.0.1", 0)) as server:
        source = parse_source(f"http://127.0.0.1:{server.server_address[1]}")
        with contextlib.closing(isolate(source, IsolationOptions(level, trust=True))) as policy:
            with serving(server):
                policy.reset(1, "pushing")
            server.server_close()
            with pytest.raises(ServerUnreachableError, match="cannot be reached"):
                policy.act(observation)
            with pytest.raises(ServerUnreachableError, match="cannot be reached"):
                policy.reset(1, "pushing")
    with pytest.raises(PolicyLoadError, match="cannot be reached"):
        try_policy(source, ["pushing"], IsolationOptions(level, trust=True))


def test_the_recipes_factory_can_be_served(tmp_path):
    names = run_recipes(tmp_path, "class Forward", "def make_policy")
    with PolicyServer(names["make_policy"], ("127.0.0.1", 0)) as server:
        episode = server.begin(json.dumps({"seed": 1, "task": "pushing"}).encode())
        assert server.act(episode, bytes(OBSERVATION_BYTES)) == [1.0, 0.0, 0.0, -1.0, 0.0]
