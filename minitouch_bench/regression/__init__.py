"""Paired comparison of runs, and the gate that stops a change for the worse.

Everything here starts from runs as they are saved; no simulator and no policy is needed.
"""

from minitouch_bench.regression.comparison import Comparison, compare_runs
from minitouch_bench.regression.gate import Ruling, Verdict, judge_runs
from minitouch_bench.regression.sequential import SequentialGate, play_order
from minitouch_bench.regression.tolerances import GateSettings, Tolerance, read_settings

__all__ = [
    "Comparison",
    "GateSettings",
    "Ruling",
    "SequentialGate",
    "Tolerance",
    "Verdict",
    "compare_runs",
    "judge_runs",
    "play_order",
    "read_settings",
]
