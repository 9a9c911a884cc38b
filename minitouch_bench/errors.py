"""The exceptions of MiniTouch-bench, all below one root.

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
    │   ├── PolicyKilledError       5   a policy's process was killed from outside
    │   └── ServerUnreachableError  5   no connection to a policy server
    ├── CheckpointChangedError      5   a policy's file changed after the evaluation began
    ├── IncompleteCheckError        5   a check could not be made: no checkpoint, or no time left
    ├── OutOfMemoryError            5   a policy's process was killed while it used much memory
    ├── HopelessRunError            5   only policy faults at first, or it takes too long
    ├── InterruptedRunError       130   Ctrl-C or SIGTERM
    └── RunDirectoryError           6   locked, corrupt, or of another run
        └── UnreadableFileError         a file of it cannot be read as one
"""

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


class ServerUnreachableError(InfrastructureError):
    """No connection to a policy server can be made."""


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
    """The first episodes of a run are all policy faults, or it would take too long.

    It can be resumed all the same.
    """

    exit_code = 5


class InterruptedRunError(MiniTouchError):
    """The user interrupted a run."""

    exit_code = 130


class RunDirectoryError(MiniTouchError):
    """The run's directory is locked, corrupt or of another run."""

    exit_code = 6


class UnreadableFileError(RunDirectoryError):
    """A file cannot be read: no permission, a link, a pipe, a device, or larger than allowed."""
