"""Tests compute as policy processes do, so that they can compare bits with them."""

import os

from minitouch_bench.arithmetic import SETTINGS

os.environ.update(SETTINGS)
