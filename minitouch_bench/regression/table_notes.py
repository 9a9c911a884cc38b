"""The sentences around the tables, the same on a screen, in Markdown and in JUnit."""

from minitouch_bench.regression.comparison import ComparedRun, Comparison, RunPair
from minitouch_bench.regression.gate import Decision, GateResult
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.labels import listed

NOT_ALIKE = "Not alike beside the policies"


def run_line(run: ComparedRun) -> str:
    """Say which run a title stands for, and what must be known of it."""
    labels = f" ({'; '.join(run.labels)})" if run.labels else ""
    return f"{run.title.capitalize()}: {run.name}, {printable(run.path)}{labels}"


def comparison_lines(comparison: RunPair) -> tuple[str, ...]:
    """Say what holds for all of one run against the first."""
    found = []
    if comparison.identical:
        found.append("The run digests are equal: every episode is the same to the last bit.")
    found += [f"{NOT_ALIKE}: {note}." for note in comparison.notes]
    return tuple(found)


def comparison_notes(comparison: Comparison) -> tuple[str, ...]:
    """Say how the figures of a comparison were made."""
    percent = f"{100 * comparison.alpha:g} %"
    return (
        "Brackets and p: of this row alone. 95 % interval of the paired difference (Tango's score "
        "interval for shares of episodes, bootstrap-t for means; episode variance only), and the "
        "exact McNemar test, or sign flips and bootstrap-t. The interval is without 0 exactly "
        "where p is at most 5 %.",
        "p adjusted and verdict: over all rows of the metric (its tasks and runs) by Holm's "
        f"method, judged at {percent}. Not clear once adjusted: the row alone would show a "
        "difference, among so many rows it may be chance.",
        "Mean: over the tasks with a goal. A metric without an arrow has no better direction.",
        "Episodes to resolve: for a power of 80 % at 5 %, if the difference is as observed. "
        "Detectable: the difference that the present episodes show with that power.",
    )


def result_line(result: GateResult) -> str:
    """Say the gate's answer in one sentence that begins with PASS or FAIL."""
    word = "FAIL" if result.exit_code else "PASS"
    if result.identical:
        reason = "the run digests are equal, every episode is the same to the last bit"
    elif result.decision is Decision.REGRESSION:
        reason = f"worse beyond the tolerance in {_named(result, Decision.REGRESSION)}"
    elif result.decision is Decision.PASSED:
        reason = "a worsening beyond the tolerance is excluded"
    elif result.episodes_needed is None:
        reason = f"inconclusive in {_named(result, Decision.INCONCLUSIVE)}"
    else:
        reason = f"inconclusive, {result.episodes_needed:,} episodes per task would settle it"
    if result.left_out:
        reason += f"; {listed(result.left_out)} left out, make the baseline again"
    return f"{word}: {reason}"


def next_line(result: GateResult) -> str:
    """Say what to type next."""
    return f"next: {result.next_command}"


def episodes_line(result: GateResult) -> str:
    """Say how many episodes the answer took, "" where all were there already."""
    used = result.episodes_used
    if used is None:
        return ""
    saved = used.planned - used.used
    if saved == 0:
        return f"{used.used} of {used.planned} episodes were played; {used.reason}"
    share = 100 * saved / used.planned
    return (
        f"stopped after {used.used} of {used.planned} episodes, {share:.0f} % saved: {used.reason}"
    )


def gate_notes(result: GateResult) -> tuple[str, ...]:
    """Say how the figures of a result were made, and what is not alike."""
    found = [f"{NOT_ALIKE}: {note}." for note in result.notes]
    alpha = f"{100 * result.settings.alpha:g} %"
    if result.unfinished:
        found.append(
            "p adjusted: e-processes, which hold wherever one stops. Brackets: for shares of "
            "episodes confidence sequences, which do so too; for means the 95 % interval of the "
            f"episodes seen. Chance of a false regression: at most {alpha}. The candidate's run "
            "is unfinished: the next command finishes it, then its episodes can be replayed."
        )
    else:
        found.append(
            "Brackets: 95 % interval of the paired difference, of the row alone. p adjusted: by "
            "Holm's method over everything judged. Chance of a false regression: at most "
            f"{alpha}. Mean: over the tasks with a goal."
        )
    found.append(
        "regression: worse beyond the tolerance, and significant. no regression: the interval "
        "excludes a worsening beyond the tolerance. inconclusive: neither."
    )
    return tuple(found)


def _named(result: GateResult, decision: Decision) -> str:
    """Name the metrics that were decided so."""
    own = [one.effect for one in result.judged if one.decision is decision]
    return listed([f"{effect.task} {effect.metric}" for effect in own])
