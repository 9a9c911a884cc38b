"""``forces.csv``: what it says, and when it is not believed."""

import numpy as np
import pandas as pd
import pytest

from minitouch_bench.runs.actions import force_curves, read_forces, write_forces
from minitouch_bench.simulation.observation import FORCES
from tests.reporting.synthetic import make_run, write


@pytest.fixture
def played():
    return make_run(tasks=("pushing", "playing"), episodes=6)


@pytest.fixture
def kept(played, tmp_path):
    run = write(played, tmp_path)
    write_forces(run.digest, played.records, tmp_path)
    return run


def test_quartiles_of_the_larger_finger_over_the_episodes_that_reached_a_step(played):
    pushing = force_curves(played.records)["pushing"]
    traces = [r.trace for r in played.records if r.spec.key.startswith("pushing/")]
    reached = [trace.touch[4, FORCES].reshape(2, 3) for trace in traces if len(trace.actions) > 3]
    largest = [max(np.linalg.norm(finger) for finger in fingers) for fingers in reached]
    assert pushing[3].episodes == len(reached)
    assert pushing[3].median == pytest.approx(np.median(largest), abs=1e-3)
    assert pushing[3].upper_quartile == pytest.approx(np.percentile(largest, 75), abs=1e-3)
    assert len(pushing) == max(len(trace.actions) for trace in traces)


def test_the_file_is_a_table_that_reads_back(kept, played, tmp_path):
    assert read_forces(kept.digest, tmp_path) == force_curves(played.records)
    frame = pd.read_csv(tmp_path / "forces.csv")
    assert set(frame["task"]) == {"pushing", "playing"}
    assert frame["run"].unique().tolist() == [kept.digest[:12]]


ROW = "{run},pushing,0,6,1,1,1"


@pytest.mark.parametrize(
    "content",
    ["", "run,task\n1,2\n", "\x00", *(ROW.replace(*one) for one in (
        ("1,1,1", "nan,1,1"), (",0,", ",1,"), ("{run}", "0"), (",6,", ",many,"),
    ))],
)  # fmt: skip
def test_what_is_not_of_this_run_or_damaged_is_not_drawn(kept, tmp_path, content):
    header = (tmp_path / "forces.csv").read_text().splitlines()[0]
    rows = content.replace("{run}", kept.digest[:12])
    (tmp_path / "forces.csv").write_text(f"{header}\n{rows}" if "pushing" in rows else rows)
    assert read_forces(kept.digest, tmp_path) == {}
    (tmp_path / "forces.csv").unlink()
    assert read_forces(kept.digest, tmp_path) == {}
