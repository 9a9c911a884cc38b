"""The stored studies: what is shown of them is what their stored trainings give."""

import re

import numpy as np
import pandas as pd
import pytest

from benchmarks.study_report import STUDIES, write_report
from minitouch_bench.runs.run import read_run
from tests.docs.test_links import DOCS

NAMES = sorted(file.stem for file in STUDIES.glob("*.toml"))
STUDY = STUDIES / "table4"
RESULTS = DOCS / "results" / "reproduction.md"


@pytest.fixture(scope="module", params=NAMES)
def fresh(request, tmp_path_factory):
    directory = tmp_path_factory.mktemp("study") / request.param
    directory.mkdir()
    write_report(directory)
    return directory


@pytest.mark.parametrize(
    "name", ["report.md", "claims.csv", "estimates.csv", "curves.csv", "tables.tex", "study.json"]
)
def test_a_stored_report_is_that_of_the_stored_trainings(fresh, name):
    stored = STUDIES / fresh.name / name
    assert stored.read_text() == (fresh / name).read_text(), "run python -m benchmarks.study_report"


def test_the_results_page_has_the_claims_of_the_report():
    report = (STUDY / "report.md").read_text()
    section = report.partition("## Claims\n")[2].partition("\n- ")[0].strip()
    assert section.count("\n") == 1 + 12  # head, ruler, and a line per claim
    assert section in RESULTS.read_text(), "copy the table of docs/studies/table4/report.md"


def test_the_results_page_has_the_changes_without_a_sense():
    report = (STUDY / "report.md").read_text()
    rows = re.findall(r"\| (.*) \| (without .*) \| Success, change \| (.*) \|\n", report)
    assert len(rows) == 3 * 2  # tasks, senses
    for task, condition, cells in rows:
        shown = cells.replace("\\", "").replace("-", "\N{MINUS SIGN}")
        assert f"| {task} | {condition} | {shown} |" in RESULTS.read_text()


def test_the_results_page_has_the_lengths_of_exploration():
    report = (STUDIES / "pushing-lengths" / "report.md").read_text().replace("\\", "")
    steps = re.findall(r"Control steps of exploration: Pushing (\S+)\.", report)
    names = ("Exploration ↑", "Success ↑", "Episode steps ↓")
    columns = [re.findall(rf"\| {name}.*?\| (.*?) \|", report) for name in names]
    assert len(steps) == 3
    for row in zip(steps, *columns, strict=True):
        assert f"| {' | '.join(row)} |" in RESULTS.read_text()


def test_nothing_stored_names_a_directory_of_a_machine():
    for file in STUDIES.glob("*/*/*/run.json"):
        assert '"source": "docs/studies/' in file.read_text(), file


def test_a_change_is_that_of_one_policy_in_the_same_episodes():
    training = STUDY / "pick-up-hac-30000-0"
    changed, standard = (read_run(training / name) for name in ("without-forces-20", "table4"))
    assert len(changed.episodes) == 20
    wanted = np.mean([row.success for row in changed.episodes]) - np.mean(
        [row.success for row in standard.episodes[:20]]
    )
    frame = pd.read_csv(STUDY / "estimates.csv", keep_default_na=False)
    row = frame.query(
        "task == 'pick-up' and method == 'hac' and seed == 0"
        " and conditions == 'without forces' and metric == 'success, change'"
    )
    assert wanted < -0.5
    assert row["value"].tolist() == pytest.approx([wanted])
