"""The bytes between the evaluation and a policy's process: packets, numbers, plain text.

A packet of the kernel's (``SOCK_SEQPACKET``) is one byte of kind, and the payload. Nothing is
pickled: an answer is read by the trusted side as numbers and text only.
"""

import os
import re
import unicodedata
from enum import IntEnum
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.policy import (
    IMAGE_SHAPE,
    TOUCH_SHAPE,
    IsolationOptions,
    Observation,
    PolicySource,
)

MAX_PAYLOAD = 64 * 1024
"""Longest payload either side accepts, in bytes."""

MAX_TEXT = 200
"""Characters kept of any text that comes from a policy."""

IMAGE_BYTES = int(np.prod(IMAGE_SHAPE))
OBSERVATION_BYTES = IMAGE_BYTES + 4 * TOUCH_SHAPE[0]

ANSI_SEQUENCE = re.compile(r"\x1b(\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(\x07|\x1b\\)?|.)")


class StartOrder(msgspec.Struct, frozen=True, tag=True):
    """The order to fork a child for an episode of one checkpoint."""

    source: PolicySource
    task: str
    seed: int
    options: IsolationOptions


class StopOrder(msgspec.Struct, frozen=True, tag=True):
    """The order to give the child so long to exit by itself, and then to end it."""

    grace_s: float


Order = StartOrder | StopOrder


class Frame(IntEnum):
    """Kinds of packet: three requests, and the answers."""

    LOAD = 1
    RESET = 2
    ACT = 3

    CONFINED = 4
    """To the order to start, before a byte of the checkpoint is looked at; or UNCONFINED."""
    UNCONFINED = 5
    LOADED = 6
    """To LOAD, with what the loader warns of; or REFUSED."""
    REFUSED = 7
    READY = 8
    """To RESET; or RAISED."""
    ACTION = 9
    """To ACT; or INVALID, where the policy gave no valid action, or RAISED."""
    RAISED = 10
    INVALID = 11


class WireError(Exception):
    """Bytes that are not of this protocol."""


def plain_line(text: str, longest: int = MAX_TEXT) -> str:
    """Return a policy's text as one printable line of at most ``longest`` characters."""
    text = ANSI_SEQUENCE.sub("", text[: 16 * longest])
    kept = (" " if unicodedata.category(c)[0] in "CZ" else c for c in text)
    line = " ".join("".join(kept).split())
    return line if len(line) <= longest else line[: longest - 1] + "…"


def describe(error: BaseException) -> str:
    """Return an exception as ``Type: message``, in one plain line."""
    try:
        message = str(error)
    except Exception:  # an exception of the policy's own can fail here too
        message = ""
    name = type(error).__name__
    return plain_line(f"{name}: {message}" if message else name)


def pack_frame(kind: Frame, payload: bytes = b"") -> bytes:
    """Return a packet's bytes."""
    return bytes((kind,)) + payload


def unpack_frame(packet: bytes) -> tuple[Frame, bytes]:
    """Return the kind and the payload of a packet.

    Raises:
        WireError: of an unknown kind.
    """
    try:
        return Frame(packet[0]), packet[1:]
    except ValueError:
        raise WireError(f"a packet of kind {packet[0]}") from None


def write_frame(channel: int, kind: Frame, payload: bytes = b"") -> None:
    """Write a packet to a socket's descriptor, waiting as long as it takes."""
    os.write(channel, pack_frame(kind, payload))


def read_frame(channel: int) -> tuple[Frame, bytes]:
    """Read a packet, waiting as long as it takes.

    Raises:
        EOFError: the other side closed.
    """
    try:
        packet = os.read(channel, 1 + MAX_PAYLOAD)
    except ConnectionError:  # closed before it read our last packet
        packet = b""
    if not packet:
        raise EOFError
    return unpack_frame(packet)


def pack_observation(observation: Observation) -> bytes:
    """Return the image's 7056 bytes, then the touch vector as 11 little-endian float32.

    Raises:
        ValueError: an array has another shape or type.
    """
    image, touch = observation["image"], observation["touch"]
    if image.shape != IMAGE_SHAPE or image.dtype != np.uint8:
        raise ValueError(f"image is {image.dtype} {image.shape}, not uint8 {IMAGE_SHAPE}")
    if touch.shape != TOUCH_SHAPE or touch.dtype != np.float32:
        raise ValueError(f"touch is {touch.dtype} {touch.shape}, not float32 {TOUCH_SHAPE}")
    return image.tobytes() + touch.astype("<f4", copy=False).tobytes()


def unpack_observation(payload: bytes) -> dict[str, NDArray[Any]]:
    """Return the observation of ``pack_observation``, in arrays that may be written to.

    Raises:
        WireError: another number of bytes.
    """
    if len(payload) != OBSERVATION_BYTES:
        raise WireError(f"an observation of {len(payload)} bytes, not {OBSERVATION_BYTES}")
    image = np.frombuffer(payload, np.uint8, IMAGE_BYTES).reshape(IMAGE_SHAPE)
    touch = np.frombuffer(payload, "<f4", offset=IMAGE_BYTES)
    return {"image": image.copy(), "touch": touch.astype(np.float32)}


def pack_action(action: NDArray[np.float32]) -> bytes:
    """Return the numbers of ``fit_action`` as little-endian float32."""
    return action.astype("<f4", copy=False).tobytes()


def unpack_action(payload: bytes, size: int) -> NDArray[np.float32]:
    """Return the action of ``pack_action``, float32 (size,).

    Raises:
        WireError: another number of bytes.
    """
    if len(payload) != 4 * size:
        raise WireError(f"an action of {len(payload)} bytes, not {4 * size}")
    return np.frombuffer(payload, "<f4").astype(np.float32)
