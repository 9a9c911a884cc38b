"""Tests compute as policy processes do, so that they can compare bits with them."""

import os
import signal

from minitouch_bench.processes import ARITHMETIC

os.environ.update(ARITHMETIC)

# A shell's background job has Ctrl-C switched off, and so has all that it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
