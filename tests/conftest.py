"""Tests compute as policy processes do, so that they can compare bits with them."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

# Asked of another process: numpy reads them when it is loaded, and this package loads it.
ASK = "import json; from minitouch_bench.processes import ARITHMETIC; print(json.dumps(ARITHMETIC))"
os.environ.update(json.loads(subprocess.check_output([sys.executable, "-c", ASK])))

# Policy processes import ``misbehaved`` and ``misbehaving`` from there.
FOLDERS = [str(Path(__file__).parent / room) for room in ("evaluation", "policies")]
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [*FOLDERS, os.environ.get("PYTHONPATH")]))

# A shell's background job has Ctrl-C switched off, and so has all that it starts.
signal.signal(signal.SIGINT, signal.default_int_handler)
