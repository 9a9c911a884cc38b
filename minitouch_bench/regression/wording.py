"""The sentences around the tables, the same on a screen, in Markdown and in JUnit."""

from collections.abc import Sequence

from minitouch_bench.regression.comparison import Comparison, Entrant, Versus
from minitouch_bench.regression.gate import Ruling, Side, Verdict
from minitouch_bench.rendering.escaping import printable


def entrant_line(entrant: Entrant) -> str:
    """Say which run a letter stands for, and what must be known of it."""
    labels = f" ({'; '.join(entrant.labels)})" if entrant.labels else ""
    return f"{entrant.letter}: {entrant.name}, {printable(entrant.place)}{labels}"


def side_line(role: str, side: Side) -> str:
    """Say which run the baseline or the candidate is."""
    labels = f" ({'; '.join(side.labels)})" if side.labels else ""
    return f"{role}: {side.name}, {printable(side.place)}{labels}"


def versus_lines(versus: Versus) -> tuple[str, ...]:
    """Say what holds for all of one run against the first."""
    found = []
    if versus.identical:
        found.append("The run digests are equal: every episode is the same to the last bit.")
    found += [f"Not alike beside the policies: {note}." for note in versus.notes]
    return tuple(found)


def comparison_notes(comparison: Comparison) -> tuple[str, ...]:
    """Say how the figures of a comparison were made."""
    percent = f"{100 * comparison.alpha:g} %"
    return (
        "Brackets: 95 % interval of the paired difference; Tango's score interval for shares, "
        "bootstrap-t for means; episode variance only (one training seed).",
        "p: exact McNemar test for shares; sign flips and bootstrap-t for means; adjusted by "
        f"Holm's method over the tasks and runs of the metric; judged at {percent}.",
        "Episodes to resolve: a task, for a power of 80 % at 5 %, if the difference is as "
        "observed. Detectable: the difference seen with that power by the present episodes.",
    )


def headline(verdict: Verdict) -> str:
    """Say the gate's answer in one sentence."""
    if verdict.identical:
        return "no regression: the run digests are equal, every episode is the same to the last bit"
    if verdict.ruling is Ruling.REGRESSION:
        worse = _named(verdict, Ruling.REGRESSION)
        return f"regression: worse beyond the tolerance in {worse}"
    if verdict.ruling is Ruling.PASSED:
        return "no regression: a worsening beyond the tolerance is excluded"
    if verdict.needed is None:
        return f"inconclusive in {_named(verdict, Ruling.INCONCLUSIVE)}"
    return f"inconclusive, needs {verdict.needed:,} episodes a task"


def effort_line(verdict: Verdict) -> str:
    """Say how many episodes the answer took, "" where all were there already."""
    effort = verdict.effort
    if effort is None:
        return ""
    saved = effort.planned - effort.used
    if saved == 0:
        return f"{effort.used} of {effort.planned} episodes were played; {effort.reason}"
    share = 100 * saved / effort.planned
    return (
        f"stopped after {effort.used} of {effort.planned} episodes, {share:.0f} % saved: "
        f"{effort.reason}"
    )


def _continuation_line(verdict: Verdict) -> str:
    """Say how to finish a run that was stopped, "" where there is none."""
    if verdict.effort is None or not verdict.effort.continuation:
        return ""
    return (
        "The candidate's run is unfinished; its episodes can be replayed once this has "
        f"finished it: {verdict.effort.continuation}"
    )


def verdict_notes(verdict: Verdict) -> tuple[str, ...]:
    """Say how the figures of a verdict were made, and what is not alike."""
    found = [f"Not alike beside the policies: {note}." for note in verdict.notes]
    alpha = f"{100 * verdict.settings.alpha:g} %"
    if verdict.effort is not None and verdict.effort.continuation:
        found.append(
            "p: e-processes, which hold wherever one stops. Brackets: for shares confidence "
            "sequences, which do so too; for means the 95 % interval of the episodes seen. "
            f"Chance of a false regression: at most {alpha}."
        )
    else:
        found.append(
            "Brackets: 95 % interval of the paired difference. p: adjusted by Holm's method "
            f"over all rows. Chance of a false regression: at most {alpha}."
        )
    found.append(
        "regression: worse beyond the tolerance, and significant. no regression: the interval "
        "excludes a worsening beyond the tolerance. inconclusive: neither."
    )
    if line := _continuation_line(verdict):
        found.append(line)
    return tuple(found)


def _named(verdict: Verdict, ruling: Ruling) -> str:
    """Name the metrics that were judged so."""
    names = [
        f"{one.effect.task} {one.effect.metric}"
        for one in verdict.judgements
        if one.ruling is ruling
    ]
    return _listed(names)


def _listed(names: Sequence[str]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]
