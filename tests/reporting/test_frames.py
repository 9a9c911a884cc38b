import csv
import io
import json
from dataclasses import replace

import pandas as pd
import pytest

from minitouch_bench.metrics.summary import EPISODE_COLUMNS, episode_row, episodes_frame
from minitouch_bench.reporting.report import build_report, table4_csv, table4_json
from minitouch_bench.reporting.tables import rows_csv


def episodes_csv(episodes):
    return rows_csv(EPISODE_COLUMNS, map(episode_row, episodes))


def test_episodes_have_exactly_the_published_columns(hac):
    text = episodes_csv(hac.rows)
    assert text.splitlines()[0] == (
        "task,index,seed,shape,outcome,success,steps,return,touch_interaction,touch_share,"
        "touch_onsets,touch_steps,touch_variance,object_movement,time_to_first_touch,arm_time,"
        "clipped_actions"
    )
    assert len(text.splitlines()) == 1 + len(hac.rows)
    assert "\r" not in text


def test_episodes_read_back_the_same(hac):
    frame = pd.read_csv(io.StringIO(episodes_csv(hac.rows)))
    assert tuple(frame.columns) == EPISODE_COLUMNS
    assert frame["success"].dtype == bool
    assert frame["object_movement"].tolist() == [e.object_movement for e in hac.rows]
    untouched = [e.first_touch_tick is None for e in hac.rows]
    assert frame["time_to_first_touch"].isna().tolist() == untouched


def test_a_frame_has_the_shape_s_family_and_the_digest_too(hac):
    frame = episodes_frame(hac.rows)
    assert tuple(frame.columns) == (*EPISODE_COLUMNS, "family", "split", "digest")
    assert frame["digest"].tolist() == [episode.digest for episode in hac.rows]
    assert frame["arm_time"].tolist() == [episode.ticks / 240 for episode in hac.rows]
    assert frame["outcome"].value_counts().sum() == len(hac.rows)
    assert episodes_frame([]).empty


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1", "@x", "\t=1", "\r=1", "\u202e=1"])
def test_no_text_is_run_as_a_formula(hac, text):
    episode = replace(hac.rows[0], shape=text)
    cells = next(csv.DictReader(io.StringIO(episodes_csv([episode]))))
    assert cells["shape"].startswith("'")


def test_a_negative_number_stays_a_number(hac):
    episode = replace(hac.rows[0], episode_return=-3.5)
    assert next(csv.DictReader(io.StringIO(episodes_csv([episode]))))["return"] == "-3.5"


def test_table4_is_long_and_labeled(hac, scripted):
    report = build_report([hac, scripted])
    rows = list(csv.DictReader(io.StringIO(table4_csv(report))))
    assert list(rows[0]) == [
        "policy",
        "task",
        "metric",
        "value",
        "low",
        "high",
        "count",
        "method",
        "source",
    ]
    own = [r for r in rows if r["policy"] == "scripted" and r["metric"] == "success"]
    assert [(r["task"], r["value"], r["count"], r["method"]) for r in own] == [
        ("pushing", "1.0", "5", "wilson")
    ]
    assert own[0]["source"] == ("run (reads the simulator's state; unofficial: 5 of 100 episodes)")
    assert json.loads(table4_json(report))[0]["policy"] == rows[0]["policy"] == "hac-seed1"
    paper = [r for r in rows if r["policy"] == "HaC" and r["task"] == "playing"]
    assert [(r["metric"], r["value"], r["low"]) for r in paper] == [
        ("touch_interaction", "388.15", "")
    ]
    assert paper[0]["source"].startswith("paper (other unit, ")


def test_a_hostile_name_is_harmless(hostile):
    rows = list(csv.DictReader(io.StringIO(table4_csv(build_report([hostile])))))
    assert rows[0]["policy"].startswith("'=")
    assert "\x1b" not in rows[0]["policy"]
