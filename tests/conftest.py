"""Tests compute as policy processes do, so that they can compare bits with them."""

import os

from minitouch_bench.processes import ARITHMETIC

os.environ.update(ARITHMETIC)
