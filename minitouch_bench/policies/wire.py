"""The bytes between the evaluation and a policy's process: frames, arrays, plain text.

A frame is a little-endian uint32 payload length, one byte of kind, and the payload. Nothing
is pickled: an answer is read by the trusted side as numbers and text only.
"""

import math
import os
import re
import struct
import unicodedata
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.policies.policy import IMAGE_SHAPE, TOUCH_SHAPE, Observation

MAX_PAYLOAD = 64 * 1024
"""Longest payload either side accepts, in bytes."""

MAX_ARRAY = 1024
"""Largest array whose numbers are sent, in bytes; of a larger one only the shape is."""

MAX_TEXT = 200
"""Characters kept of any text that comes from a policy."""

IMAGE_BYTES = int(np.prod(IMAGE_SHAPE))
OBSERVATION_BYTES = IMAGE_BYTES + 4 * TOUCH_SHAPE[0]

HEADER = struct.Struct("<IB")
ARRAY_HEADER = struct.Struct("<8sB")
MAX_AXES = 8
NO_NUMBERS = "|O"
"""Type of an action that is not an array of plain numbers."""

ACTION_TYPES = {np.dtype(code).str: np.dtype(code) for code in "?bhilqBHILQefdgFDG"}
"""The types of number that an action may name, by name; numpy's own reading of a name is a
parser, which no policy may feed."""

ANSI_SEQUENCE = re.compile(r"\x1b(\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(\x07|\x1b\\)?|.)")


class Frame(IntEnum):
    """Kinds of frame: three requests, and the answers."""

    LOAD = 1
    RESET = 2
    ACT = 3

    CONFINED = 4
    """To the order to start, before a byte of the checkpoint is looked at; or UNCONFINED."""
    UNCONFINED = 5
    LOADED = 6
    """To LOAD; or REFUSED."""
    REFUSED = 7
    READY = 8
    """To RESET; or RAISED."""
    ACTION = 9
    """To ACT; or RAISED."""
    RAISED = 10


class WireError(Exception):
    """Bytes that are not of this protocol."""


def plain_line(text: str) -> str:
    """Return a policy's text as one printable line of at most 200 characters."""
    text = ANSI_SEQUENCE.sub("", text[: 16 * MAX_TEXT])
    kept = (" " if unicodedata.category(c)[0] in "CZ" else c for c in text)
    line = " ".join("".join(kept).split())
    return line if len(line) <= MAX_TEXT else line[: MAX_TEXT - 1] + "…"


def describe(error: BaseException) -> str:
    """Return an exception as ``Type: message``, in one plain line."""
    try:
        message = str(error)
    except Exception:  # an exception of the policy's own can fail here too
        message = ""
    name = type(error).__name__
    return plain_line(f"{name}: {message}" if message else name)


def pack_frame(kind: Frame, payload: bytes = b"") -> bytes:
    """Return a frame's bytes."""
    return HEADER.pack(len(payload), kind) + payload


def unpack_header(header: bytes) -> tuple[int, Frame]:
    """Return the payload's length and the kind of a frame.

    Raises:
        WireError: too long, or of an unknown kind.
    """
    length, kind = HEADER.unpack(header)
    if length > MAX_PAYLOAD or kind not in Frame.__members__.values():
        raise WireError(f"frame of kind {kind} with {length} bytes")
    return length, Frame(kind)


def write_frame(descriptor: int, kind: Frame, payload: bytes = b"") -> None:
    """Write a whole frame, waiting as long as it takes."""
    rest = memoryview(pack_frame(kind, payload))
    while rest:
        rest = rest[os.write(descriptor, rest) :]


def read_exactly(descriptor: int, count: int) -> bytes:
    """Read a number of bytes, waiting as long as it takes.

    Raises:
        EOFError: the other side closed.
    """
    parts = bytearray()
    while len(parts) < count:
        part = os.read(descriptor, count - len(parts))
        if not part:
            raise EOFError
        parts += part
    return bytes(parts)


def read_frame(descriptor: int) -> tuple[Frame, bytes]:
    """Read a whole frame, waiting as long as it takes."""
    length, kind = unpack_header(read_exactly(descriptor, HEADER.size))
    return kind, read_exactly(descriptor, length)


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


def pack_action(raw: object) -> bytes:
    """Return type, shape and numbers of whatever a policy gave as its action.

    What is no array of plain numbers, or too large, goes without its numbers: the trusted
    side refuses it by its type or shape.
    """
    try:
        array = np.asarray(raw)
    except Exception:  # a ragged list, or an object whose conversion raises
        array = np.array(None)
    if array.ndim > MAX_AXES:
        array = array.reshape(-1)
    plain = array.dtype.kind in "biufc" and array.nbytes <= MAX_ARRAY
    type_name = array.dtype.str if array.dtype.kind in "biufc" else NO_NUMBERS
    head = ARRAY_HEADER.pack(type_name.encode(), array.ndim)
    shape = struct.pack(f"<{array.ndim}Q", *array.shape)
    return head + shape + (array.tobytes() if plain else b"")


def unpack_action(payload: bytes) -> NDArray[Any]:
    """Return the array of ``pack_action``, all zero where its numbers were too many to send.

    Raises:
        WireError: the payload describes no array.
    """
    try:
        name, axes = ARRAY_HEADER.unpack_from(payload)
        type_name = name.rstrip(b"\0").decode("ascii")
        if type_name == NO_NUMBERS:
            return np.array(None)
        dtype = ACTION_TYPES[type_name]
        shape = struct.unpack_from(f"<{min(axes, MAX_AXES)}Q", payload, ARRAY_HEADER.size)
        body = payload[ARRAY_HEADER.size + 8 * len(shape) :]
        size = math.prod(shape) * dtype.itemsize
        if size > MAX_ARRAY and not body:
            return np.broadcast_to(np.zeros((), dtype), shape)
        return np.frombuffer(body, dtype).reshape(shape)
    except Exception as error:  # whatever these bytes cause, they are the policy's
        raise WireError("an action whose type, shape and numbers do not fit") from error
