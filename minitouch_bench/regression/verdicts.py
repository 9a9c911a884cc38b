"""The verdict of a sequential gate: at an early stop, or over a run that was played to its end."""

import shlex
from dataclasses import replace

from minitouch_bench.records import RunHeader, SavedRun
from minitouch_bench.regression.comparison import differences_of_holding, find_changes
from minitouch_bench.regression.gate import Effort, Side, Verdict, judge_runs
from minitouch_bench.regression.sequential import Levels, SequentialGate
from minitouch_bench.regression.tolerances import GateSettings
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.labels import reproduce_command, run_labels


def early_verdict(
    gate: SequentialGate,
    baseline: SavedRun,
    place: str,
    candidate: Side,
    header: RunHeader,
) -> Verdict:
    """Return the verdict of a gate that is certain; ``header`` is the candidate's."""
    return Verdict(
        baseline=Side(printable(baseline.name), place, run_labels(baseline)),
        candidate=candidate,
        ruling=gate.ruling,
        settings=gate.settings,
        identical=False,
        judgements=gate.judgements(),
        changes=find_changes(gate.pairs, (place, candidate.place)),
        notes=differences_of_holding(baseline.header, header),
        effort=Effort(gate.used, gate.planned, gate.reason, _continuation(header, candidate)),
    )


def final_verdict(
    baseline: SavedRun, candidate: SavedRun, places: tuple[str, str], settings: GateSettings
) -> Verdict:
    """Judge a whole run at the part of the level that early stops have left."""
    level = Levels.of(settings, tests=1).final
    verdict = judge_runs(baseline, candidate, places, replace(settings, alpha=level))
    count = len(candidate.episodes)
    effort = Effort(count, count, "no answer was certain before the end")
    return replace(verdict, settings=settings, effort=effort)


def _continuation(header: RunHeader, candidate: Side) -> str:
    """Return the command that plays the rest of a candidate's episodes."""
    return f"{reproduce_command(header)} {shlex.join(['--output', candidate.place, '--resume'])}"
