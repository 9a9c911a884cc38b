"""The stored studies: what is shown of them is what their stored rows give."""

import pandas as pd
import pytest

from experiments.analysis import (
    STUDIES,
    analyze,
    changes_of,
    read_rows,
    stored_studies,
    write_results,
)
from experiments.grid import FILES, KEY, check_lock, read_design
from experiments.light import analysis as light
from experiments.touch import analysis as touch
from tests.altered import ROOT

DESIGNS = {folder.name: folder / "design.toml" for folder in stored_studies()}


@pytest.mark.parametrize("name", DESIGNS)
def test_the_stored_tables_follow_from_the_stored_rows(name):
    stored = STUDIES / name
    results = analyze(read_design(DESIGNS[name]), stored)
    assert results.report == (stored / "report.md").read_text(), "python -m experiments.analysis"


@pytest.mark.parametrize("name", DESIGNS)
def test_stored_estimates_are_means_of_stored_episodes(name):
    episodes, estimates = (read_rows(STUDIES / name, file) for file in ("episodes", "estimates"))
    columns = {"success": "success", "episode_steps": "steps", "touch_share": "touch_share"}
    run = [*KEY, "suite", "conditions"]
    for role, metric, column in [
        *(("final", *pair) for pair in columns.items()), ("exploration", "exploration", "success")
    ]:  # fmt: skip
        means = episodes[episodes["role"] == role].groupby(run)[column].agg(["mean", "size"])
        shown = estimates[estimates["metric"] == metric].set_index(run)
        both = shown.join(means)
        assert len(shown)
        assert both["value"].tolist() == pytest.approx(both["mean"].tolist())
        assert both["episodes"].tolist() == both["size"].tolist()


@pytest.mark.parametrize(
    ("study", "analyze_it", "claims"),
    [(touch, touch.analyze_touch, "pooled"), (light, light.analyze_light, "paired")],
    ids=["touch", "light"],
)
def test_the_page_of_a_locked_study_follows_from_the_stored_rows(study, analyze_it, claims):
    stored, design = study.DESIGN.parent, read_design(study.DESIGN)
    check_lock(design, stored)
    results, module = analyze_it(design, stored), study.__name__
    assert results.page == (stored / f"{stored.name}.md").read_text(), f"python -m {module}"
    assert results.judged.to_csv(index=False) == (stored / f"{claims}.csv").read_text()


def test_a_change_is_of_the_episodes_that_both_conditions_have(tmp_path):
    rows = read_rows(STUDIES / "touch", "episodes")
    fewer = rows[(rows["conditions"] != "") | (rows["index"] < 10)]
    assert {*changes_of(rows)["episodes"]} == {20}
    assert {*changes_of(fewer)["episodes"]} == {10}
    assert changes_of(rows[rows["conditions"] != ""]).empty
    with pytest.raises(SystemExit, match="no training is finished"):
        read_rows(tmp_path, "curves")


@pytest.mark.parametrize("study", ["touch", "light"])
def test_the_design_is_the_one_that_was_locked(study):
    design = read_design(ROOT / "experiments" / study / "design.toml")
    assert design["locked"]
    assert f"`{design['digest']}`" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_results_are_written_beside_the_rows(tmp_path):
    """With a second length of exploration and a split of shapes, every figure is drawn."""
    for name in FILES:
        rows = read_rows(STUDIES / "touch", name)
        rows = rows[(rows["task"] == "pick-up") & (rows["training_seed"] < 22)]
        longer = rows.assign(exploration_steps=2 * rows["exploration_steps"])
        parts = [rows, longer]
        if name == "estimates":
            of_split = rows[(rows["metric"] == "success") & (rows["conditions"] == "")]
            parts += [
                of_split.assign(suite="novel-shapes", metric=f"success, {split}")
                for split in ("train", "held-out")
            ]
        pd.concat(parts).to_csv(tmp_path / f"{name}.csv", index=False)
    write_results(read_design(STUDIES / "methods" / "design.toml"), tmp_path)
    written = {file.name for file in tmp_path.rglob("*.*")}
    drawn = {"curves.svg", "movement.svg", "lengths.svg", "novel-shapes.svg", "conditions.svg"}
    assert {"report.md", *drawn} <= written
