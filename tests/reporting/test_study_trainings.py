import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import PROGRESS_FILE
from minitouch_bench.reporting.study import (
    StudyResults,
    StudyTraining,
    last_progress,
    state_lines,
    trainings_table,
)


def training_at(directory, seed, text):
    training = StudyTraining("opening", "hac", seed, 8000)
    (directory / training.name).mkdir()
    if text is not None:
        (directory / training.name / PROGRESS_FILE).write_text(text)
    return training


def test_each_training_says_how_far_it_is(tmp_path):
    head = "step,episodes,success,touch_share,seconds\n"
    rows = head + "500,2,0.5,0.1,30.0\n1000,0,,0.2,60.0\n15"  # the last one is torn
    done, failed, under_way, begun, waiting, partly = (
        training_at(tmp_path, seed, text)
        for seed, text in enumerate([rows, rows, rows, "", head, rows])
    )
    left = (under_way, begun, waiting, partly)
    runs = {done: (object(),), partly: (object(),)}
    results = StudyResults(tmp_path, (done,), {failed: "a full disk"}, left, left[:-1], runs)
    found = {
        row.heads[0]: [cell.text for cell in row.cells] for row in trainings_table(results).rows
    }
    assert found == {
        "opening-hac-8000-0": ["done", "1,000", "1.0 min"],
        "opening-hac-8000-1": ["failed: a full disk", "1,000", "1.0 min"],
        "opening-hac-8000-2": ["under way", "1,000", "1.0 min"],
        "opening-hac-8000-3": ["waiting", "0", "0.0 min"],
        "opening-hac-8000-4": ["waiting", "0", "0.0 min"],
        "opening-hac-8000-5": ["evaluated in part", "1,000", "1.0 min"],
    }
    # Three of those left are to be trained, one only to be evaluated.
    assert "left train for about 3 minutes" in state_lines(results)[0]


@pytest.mark.parametrize("text", ["step\n500\n", "\0\1\2\n", "step,episodes\nmany,few\n"])
def test_damaged_curves_are_named(tmp_path, text):
    training = training_at(tmp_path, 0, text)
    with pytest.raises(RunDirectoryError, match=r"progress\.csv cannot be read"):
        last_progress(tmp_path, training)
