"""Runs of one task each are joined to the very run that they are parts of."""

from dataclasses import replace
from pathlib import Path

import pytest

from experiments.grid import Cell
from experiments.row import collect, join_runs
from minitouch_bench.metrics.summary import Summary
from minitouch_bench.runs.run import read_run

WHOLE = Path("submissions/hac/seed-20/table4")


def only(run, task):
    """Return the part of a run that is of one task."""
    header = replace(run.header, plan=replace(run.plan, tasks=(task,)))
    return replace(
        run,
        header=header,
        summary=Summary(tuple(one for one in run.summary.tasks if one.task == task)),
        rows=tuple(row for row in run.rows if row.task == task),
        exploration_rows=tuple(row for row in run.exploration_rows if row.task == task),
        directory=None,
        kept_actions={spec.key: run.actions[spec.key] for spec in header.specs()},
    )


@pytest.fixture(scope="module")
def whole():
    return read_run(WHOLE)


@pytest.fixture
def parts(whole):
    return {task: only(whole, task) for task in reversed(whole.tasks)}


def test_the_parts_of_a_run_are_joined_to_it(whole, parts, tmp_path):
    join_runs(whole.header, parts, tmp_path)
    joined = read_run(tmp_path)
    for name in ("digest", "header", "summary", "faults", "rows", "exploration_rows"):
        assert getattr(joined, name) == getattr(whole, name)
    assert joined.environment.wall_s == pytest.approx(4 * whole.environment.wall_s)
    assert {key: actions.tobytes() for key, actions in joined.actions.items()} == {
        key: actions.tobytes() for key, actions in whole.actions.items()
    }


def test_an_arm_without_exploration_has_final_policies_alone(tmp_path):
    cells = [Cell("pushing", "sac", 10, 0), Cell("opening", "sac", 10, 0)]
    for cell in cells:
        (tmp_path / cell.name).mkdir()
        (tmp_path / cell.name / "final.safetensors").touch()
    final, exploration = collect(cells, tmp_path, tmp_path / "row")
    assert {file.name for file in final.iterdir()} == {"pushing.safetensors", "opening.safetensors"}
    assert not [*exploration.iterdir()]


def test_parts_of_another_evaluation_are_refused(whole, parts, tmp_path):
    part = parts["pushing"]
    newer = replace(part.environment, packages={**part.environment.packages, "numpy": "9"})
    fewer = replace(part.header, plan=replace(part.plan, episodes=1))
    for odd in (replace(part, environment=newer), replace(part, header=fewer)):
        with pytest.raises(SystemExit, match="not those of one evaluation"):
            join_runs(whole.header, {**parts, "pushing": odd}, tmp_path)
    assert not [*tmp_path.iterdir()]
