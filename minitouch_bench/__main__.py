"""What the installed command starts: the application, with an end that a user can read.

A standard output or error that is closed or full ends no command: what it keeps is kept, and the
exit code is its own.
"""

import errno
import io
import os
import signal
import sys

from minitouch_bench.errors import InfrastructureError, InterruptedRunError

STOPS = (signal.SIGINT, signal.SIGTERM)
"""What ends a command early: Ctrl-C, and what ``kill``, containers and clusters send."""


class _Output(io.FileIO):
    """Standard output or error, which takes everything; what cannot be written is dropped."""

    def __init__(self, descriptor: int) -> None:
        self.failure: OSError | None = None
        super().__init__(descriptor, "wb", closefd=False)

    def write(self, data) -> int:  # type: ignore[no-untyped-def]
        """Write, and keep the first failure."""
        if self.failure is None:
            try:
                return super().write(data) or 0
            except OSError as error:
                self.failure = error
        return len(data)


def main() -> None:
    """Run the command line; Ctrl-C and SIGTERM end it alike, cleaned up and without a traceback."""
    _open_closed()
    # Only what a command prints goes to standard output. A policy beside the simulator, a child
    # and a library's C code write to file descriptor 1, which leads to standard error from here on.
    output, notes = _Output(os.dup(1)), _Output(2)
    os.dup2(2, 1)
    sys.stdout, sys.stderr = _text(output), _text(notes)
    code: object = 0
    try:
        # Not at the top: loading takes a second in which Ctrl-C must be caught as well.
        from minitouch_bench.commands.app import main as run_application  # noqa: PLC0415

        for number in STOPS:
            if signal.getsignal(number) is not signal.SIG_IGN:  # as of a background job
                signal.signal(number, signal.default_int_handler)
        run_application()
    except SystemExit as end:
        code = end.code
    except KeyboardInterrupt:
        sys.stderr.write("minitouch-bench: interrupted\n")
        code = InterruptedRunError.exit_code
    for number in STOPS:  # one more ends it without a traceback
        signal.signal(number, signal.SIG_DFL)
    sys.stdout.flush()
    sys.stdout = sys.stderr  # of what a policy prints when Python ends
    if output.failure is not None and output.failure.errno != errno.EPIPE:
        why = output.failure.strerror
        sys.stderr.write(f"minitouch-bench: standard output cannot be written: {why}\n")
        code = code or InfrastructureError.exit_code
    sys.stderr.flush()
    sys.exit(code)  # type: ignore[arg-type]


def _open_closed() -> None:
    """Let standard streams that are closed lead nowhere, so that no file takes their number."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
            os.set_inheritable(descriptor, True)


def _text(output: _Output) -> io.TextIOWrapper:
    return io.TextIOWrapper(
        io.BufferedWriter(output), "utf-8", "backslashreplace", line_buffering=True
    )


if __name__ == "__main__":
    main()
