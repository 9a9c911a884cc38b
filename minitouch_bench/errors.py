"""The exceptions of MiniTouch-bench, all below one root; and strangers' text, safe to print.

::

    MiniTouchError                  root; carries the exit code of the command line
    ├── UsageError                  2   a wrong option, task, suite or shape set
    ├── MissingExtraError           3   an optional package is needed and not installed
    ├── IsolationError              3   a policy cannot be isolated as asked on this machine
    ├── PolicyError                 3   a policy cannot be used
    │   ├── PolicyLoadError         3   the file is unreadable, unsafe or of the wrong form
    │   └── PolicyFaultError        4   the policy failed inside an episode
    │       ├── InvalidActionError      wrong length, type, NaN or infinite
    │       ├── PolicyTimeoutError      no answer before the deadline
    │       ├── PolicyExitError         its process ended
    │       └── PolicyRaisedError       its code raised
    ├── InfrastructureError         5   a worker died, a file could not be written
    │   └── PolicyKilledError       5   a policy's process was killed from outside
    ├── CheckpointChangedError      5   a policy's file changed after the evaluation began
    ├── IncompleteCheckError        5   a check could not be made: no checkpoint, or no time left
    ├── OutOfMemoryError            5   a policy's process was killed while it used much memory
    ├── HopelessRunError            5   its first episodes are all policy faults
    ├── InterruptedRunError       130   Ctrl-C
    └── RunDirectoryError           6   locked, corrupt, or of another run
        └── UnreadableFileError         a file of it cannot be read as one
"""

import os.path
import re
import unicodedata

CHECK_FAILED = 1
"""Exit code of a check that was made and found a difference; no error is raised for it."""


class MiniTouchError(Exception):
    """Base class of every error that a user can see; its text is one or two clear lines."""

    exit_code = 1


class UsageError(MiniTouchError):
    """An argument is wrong."""

    exit_code = 2


class MissingExtraError(MiniTouchError):
    """An optional package is not installed."""

    exit_code = 3


class IsolationError(MiniTouchError):
    """A policy cannot be isolated as asked on this machine."""

    exit_code = 3


class PolicyError(MiniTouchError):
    """A policy cannot be used."""

    exit_code = 3


class PolicyLoadError(PolicyError):
    """A checkpoint is unreadable, unsafe or of the wrong form."""


class PolicyFaultError(PolicyError):
    """The policy failed inside an episode; the episode counts as failed."""

    exit_code = 4


class InvalidActionError(PolicyFaultError):
    """The action has a wrong length or type, or contains NaN or infinity."""


class PolicyTimeoutError(PolicyFaultError):
    """The policy gave no answer before its deadline."""


class PolicyExitError(PolicyFaultError):
    """The policy's process ended."""


class PolicyRaisedError(PolicyFaultError):
    """The policy's code raised an exception; the text is its own, and is told as such."""

    def __str__(self) -> str:
        return f"the policy said: {super().__str__()}"


class InfrastructureError(MiniTouchError):
    """Something of ours or of the machine failed; never the policy's fault."""

    exit_code = 5


class PolicyKilledError(InfrastructureError):
    """The policy's process was killed by a SIGKILL that was not ours, as where memory ran out."""


class CheckpointChangedError(MiniTouchError):
    """A policy's file is another one than when the evaluation began, or cannot be read now."""

    exit_code = 5


class IncompleteCheckError(MiniTouchError):
    """A check could not be made: something it needs is missing, or its time is up."""

    exit_code = 5


class OutOfMemoryError(MiniTouchError):
    """A policy's process was killed while it used much memory; its episode is not tried again.

    The policy may have wanted it, to be given another attempt.
    """

    exit_code = 5


class HopelessRunError(MiniTouchError):
    """The first episodes of a run are all policy faults; it can be resumed all the same."""

    exit_code = 5


class InterruptedRunError(MiniTouchError):
    """The user interrupted a run."""

    exit_code = 130


class RunDirectoryError(MiniTouchError):
    """The run's directory is locked, corrupt or of another run."""

    exit_code = 6


class UnreadableFileError(RunDirectoryError):
    """A file cannot be read: no permission, a link, a pipe, a device, or larger than allowed."""


# What they quote

UNSEEN_CHARACTERS = frozenset(
    "\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0"
    + "".join(map(chr, (*range(0x180B, 0x1810), *range(0xFE00, 0xFE10), *range(0xE0100, 0xE01F0))))
)
"""What shows nothing though Unicode calls it a letter or a mark; the rest is control or format."""


def printable(text: str) -> str:
    """Return the text on one line, without control, direction, surrogate and unseen characters."""
    if text.isascii() and text.isprintable():
        return text.strip()
    spaced = (" " if character.isspace() else character for character in text)
    return "".join(filter(_is_seen, spaced)).strip()


def _is_seen(character: str) -> bool:
    is_control = unicodedata.category(character).startswith("C")
    return character not in UNSEEN_CHARACTERS and not is_control


MAX_TEXT = 200
"""Characters kept of any text that comes from a policy."""

ANSI_SEQUENCE = re.compile(r"\x1b(\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(\x07|\x1b\\)?|.)")


def plain_line(text: str, longest: int = MAX_TEXT) -> str:
    """Return a policy's text as one printable line of at most ``longest`` characters."""
    line = " ".join(printable(ANSI_SEQUENCE.sub("", text[: 16 * longest])).split())
    return line if len(line) <= longest else line[: longest - 1] + "…"


NO_OWN_FILE = re.compile(
    "<|.*/(site|dist)-packages/|"
    + "|".join(re.escape(f"{os.path.dirname(file)}/") for file in (os.__file__, __file__))
)
"""How the file of code begins that no policy brings: none, an installed one, Python's or ours."""


def describe(error: BaseException) -> str:
    """Return an exception as ``Type: message (file:line in function)``, in one plain line.

    The place is the innermost line of a policy's own code, if it was raised in such code.
    """
    try:
        message = str(error)
    except Exception:  # an exception of the policy's own can fail here too
        message = ""
    name, place = type(error).__name__, own_place(error)
    return plain_line(f"{name}: {message}" if message else name, MAX_TEXT - len(place)) + place


def own_place(error: BaseException) -> str:
    """Return `` (file:line in function)``, the file without its folder, or "".

    Read as Python keeps it, past what an exception's class or a subclass of str defines.
    """
    place, step = "", BaseException.__dict__["__traceback__"].__get__(error)
    while step is not None:
        code = step.tb_frame.f_code
        file, function = map(str.__str__, (code.co_filename, code.co_name))
        if not NO_OWN_FILE.match(file):
            line = f"{os.path.basename(file)}:{step.tb_lineno} in {function}"
            place = f" ({plain_line(line, MAX_TEXT // 2)})"
        step = step.tb_next
    return place
