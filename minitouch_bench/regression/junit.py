"""A gate's verdict as JUnit XML, one test case a metric of a task."""

from xml.etree import ElementTree

from minitouch_bench.regression.gate import Judgement, Ruling, Verdict
from minitouch_bench.regression.tables import difference_text, metric_label, p_text, ruling_text
from minitouch_bench.regression.wording import effort_line, headline, verdict_notes
from minitouch_bench.rendering.escaping import printable

SUITE = "minitouch-bench regress"


def verdict_junit(verdict: Verdict) -> str:
    """Write a verdict as a JUnit report.

    A regression is a failure, and what is inconclusive is skipped, with ``strict`` a failure
    too. Source of the form: the Ant task "JUnitReport", as CI servers read it.
    """
    failed = [one for one in verdict.judgements if _is_failure(one, verdict)]
    skipped = [one for one in verdict.judgements if _is_skipped(one, verdict)]
    counts = {
        "tests": str(len(verdict.judgements)),
        "failures": str(len(failed)),
        "errors": "0",
        "skipped": str(len(skipped)),
        "time": "0",
    }
    root = ElementTree.Element("testsuites", {"name": SUITE, **counts})
    suite = ElementTree.SubElement(root, "testsuite", {"name": SUITE, **counts})
    properties = ElementTree.SubElement(suite, "properties")
    for name, value in (
        ("baseline", verdict.baseline.place),
        ("candidate", verdict.candidate.place),
        ("alpha", f"{verdict.settings.alpha:g}"),
        ("verdict", headline(verdict)),
    ):
        ElementTree.SubElement(properties, "property", {"name": name, "value": printable(value)})
    for judgement in verdict.judgements:
        _add_case(suite, judgement, verdict)
    lines = [effort_line(verdict), *verdict_notes(verdict)]
    ElementTree.SubElement(suite, "system-out").text = "\n".join(
        printable(line) for line in lines if line
    )
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _add_case(suite: ElementTree.Element, judgement: Judgement, verdict: Verdict) -> None:
    effect = judgement.effect
    case = ElementTree.SubElement(
        suite,
        "testcase",
        {"classname": f"minitouch.{effect.task}", "name": effect.metric, "time": "0"},
    )
    message = printable(f"{ruling_text(judgement)}: {difference_text(effect)}")
    details = printable(
        f"{metric_label(effect.metric)}: candidate minus baseline {difference_text(effect)}, "
        f"tolerance {judgement.allowed:g}, p {p_text(judgement.p_value)}, "
        f"{effect.count} episodes"
    )
    if _is_failure(judgement, verdict):
        failure = ElementTree.SubElement(
            case, "failure", {"message": message, "type": judgement.ruling.value}
        )
        failure.text = details
    elif _is_skipped(judgement, verdict):
        ElementTree.SubElement(case, "skipped", {"message": message}).text = details
    else:
        ElementTree.SubElement(case, "system-out").text = details


def _is_failure(judgement: Judgement, verdict: Verdict) -> bool:
    strict = verdict.settings.strict and judgement.ruling is Ruling.INCONCLUSIVE
    return judgement.ruling is Ruling.REGRESSION or strict


def _is_skipped(judgement: Judgement, verdict: Verdict) -> bool:
    """Tell whether nothing was decided."""
    undecided = judgement.ruling in (Ruling.INCONCLUSIVE, Ruling.OPEN)
    return undecided and not _is_failure(judgement, verdict)
