import socket

import numpy as np
import pytest

from minitouch_bench.policies.wire import (
    MAX_PAYLOAD,
    Frame,
    WireError,
    describe,
    pack_action,
    pack_observation,
    plain_line,
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


@pytest.mark.parametrize(
    "raw",
    [
        np.array([1.5, np.nan, np.inf, -0.0], np.float32),
        np.zeros((1, 5)),
        np.arange(4),
        np.zeros((0,), np.float32),
        np.float16(3.0),
        np.array([True]),
    ],
)
def test_numbers_survive_bit_by_bit(raw):
    back = unpack_action(pack_action(raw))
    assert back.dtype == raw.dtype
    assert back.shape == raw.shape
    assert back.tobytes() == raw.tobytes()


def test_large_arrays_travel_without_their_numbers():
    payload = pack_action(np.ones((1000, 1000)))
    assert len(payload) < 100
    assert unpack_action(payload).shape == (1000, 1000)


@pytest.mark.parametrize("raw", [None, "text", {"a": 1}, [[1.0], [1.0, 2.0]], object()])
def test_what_is_no_array_becomes_an_object(raw):
    assert unpack_action(pack_action(raw)).dtype == object


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"<f4",
        b"<f4\0\0\0\0\0\1" + b"\4" + b"\0" * 7,
        b"nonsense\1" + b"\4" + b"\0" * 23,
        b"<f8\0\0\0\0\0\2" + b"\xff" * 16 + b"12345678",
        b"<f8\0\0\0\0\0\2" + b"\xff" * 16,
        b"<f8\0\0\0\0\0\2" + b"\xff" * 8 + b"\0" * 8,
        b",\0\0\0\0\0\0\0\0",
        b"<M8[s]\0\0\0",
    ],
)
def test_hostile_actions_are_refused(payload):
    with pytest.raises(WireError):
        unpack_action(payload)


def test_random_bytes_are_an_action_or_refused_and_nothing_else():
    generator = np.random.default_rng(0)
    real = pack_action(np.ones(4, np.float32))
    for _ in range(2000):
        payload = bytearray(real)
        for at in generator.integers(0, len(real), generator.integers(1, 8)):
            payload[at] = generator.integers(0, 256)
        try:
            assert isinstance(unpack_action(bytes(payload)), np.ndarray)
        except WireError:
            continue


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


def test_an_end_that_leaves_packets_unread_is_an_end():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with theirs:
        write_frame(theirs.fileno(), Frame.READY)
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
