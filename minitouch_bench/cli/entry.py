"""What the installed command starts: the application, quietly ended by Ctrl-C from the first."""

import sys

INTERRUPTED = 130


def main() -> None:
    """Run the command line; Ctrl-C ends it without a traceback, even while it is loading."""
    try:
        # Not at the top: loading takes a second in which Ctrl-C must be caught as well.
        from minitouch_bench.cli.app import main as run_application

        run_application()
    except KeyboardInterrupt:
        sys.stderr.write("minitouch-bench: interrupted\n")
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
