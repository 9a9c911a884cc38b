import socket

import numpy as np
import pytest

from minitouch_bench.errors import describe, plain_line
from minitouch_bench.policies.wire import (
    MAX_PAYLOAD,
    Frame,
    WireError,
    pack_action,
    pack_observation,
    read_frame,
    unpack_action,
    unpack_frame,
    unpack_observation,
    write_frame,
)


def test_observation_survives(observation):
    payload = pack_observation(observation)
    assert len(payload) == 7056 + 44
    back = unpack_observation(payload)
    assert np.array_equal(back["image"], observation["image"])
    assert np.array_equal(back["touch"], observation["touch"])
    back["image"][0, 0, 0] = 1  # a policy may write into its copy


def test_observation_of_another_form_is_refused(observation):
    with pytest.raises(ValueError, match="image"):
        pack_observation({**observation, "image": observation["image"][0]})
    with pytest.raises(ValueError, match="touch"):
        pack_observation({**observation, "touch": observation["touch"].astype(float)})
    with pytest.raises(WireError):
        unpack_observation(b"123")


def test_an_action_survives_and_one_of_another_length_is_refused():
    action = np.array([1.0, -0.5, 1e-8, -0.0], np.float32)
    payload = pack_action(action)
    assert unpack_action(payload, 4).tobytes() == action.tobytes()
    for other in (b"", payload[:-1], payload + b"\0", payload * 1000):
        with pytest.raises(WireError, match=f"an action of {len(other)} bytes, not 16"):
            unpack_action(other, 4)


@pytest.mark.parametrize("kind", [0, 99, 255])
def test_packets_of_an_unknown_kind_are_refused(kind):
    with pytest.raises(WireError, match=f"of kind {kind}"):
        unpack_frame(bytes((kind, 1, 2)))


def test_packets_survive_a_socket_one_by_one():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        for payload in (b"text", b"", bytes(MAX_PAYLOAD)):
            write_frame(ours.fileno(), Frame.RAISED, payload)
            write_frame(ours.fileno(), Frame.READY)
            assert read_frame(theirs.fileno()) == (Frame.RAISED, payload)
            assert read_frame(theirs.fileno()) == (Frame.READY, b"")
        ours.close()
        with pytest.raises(EOFError):
            read_frame(theirs.fileno())


def test_text_of_a_policy_becomes_one_plain_line():
    text = "a\x1b[31mred\x1b[0m\r\nb\x07\u202ec\t\x1b]0;title\x07d"
    assert plain_line(text) == "ared b c d"
    assert len(plain_line("x" * 100_000)) == 200


def test_an_exception_that_cannot_speak_is_still_named():
    class MuteError(Exception):
        def __str__(self):
            raise RuntimeError

    assert describe(MuteError()) == "MuteError"
    assert describe(ValueError("no\nway")) == "ValueError: no way"
    assert describe(ValueError()) == "ValueError"
