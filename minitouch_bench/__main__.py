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
    """Run the command line; Ctrl-C ends it without a traceback, even while it is loading."""
    _open_closed()
    output, notes = _Output(1), _Output(2)
    sys.stdout, sys.stderr = _text(output), _text(notes)
    code: object = 0
    interrupted = False
    try:
        # Not at the top: loading takes a second in which Ctrl-C must be caught as well.
        from minitouch_bench.commands.app import main as run_application  # noqa: PLC0415

        run_application()
    except SystemExit as end:
        code = end.code
    except KeyboardInterrupt:
        interrupted = True
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # one more Ctrl-C ends it without a traceback
    if interrupted:
        sys.stderr.write("minitouch-bench: interrupted\n")
        code = InterruptedRunError.exit_code
    sys.stdout.flush()
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
