from minitouch_bench.metrics.definitions import (
    METRICS,
    UP,
    ShownIn,
    metrics_shown_in,
    ranking_metric,
)
from minitouch_bench.protocol.minitouch import TASK_NAMES


def test_table4_has_the_rows_of_the_paper_and_what_playing_is_ranked_by():
    touch = ("touch_interaction", "touch_share")
    goal = ("exploration", "success", "episode_steps")
    assert metrics_shown_in(ShownIn.TABLE4) == (*goal, *touch)
    assert metrics_shown_in(ShownIn.TABLE4, "playing") == touch


def test_a_task_is_ranked_by_a_share_of_which_more_is_better():
    ranked = {task: METRICS[ranking_metric(task)] for task in TASK_NAMES}
    assert all(metric.is_fraction for metric in ranked.values())
    assert {metric.direction_in(task) for task, metric in ranked.items()} == {UP}
    touch = METRICS["touch_share"]
    assert [task for task in TASK_NAMES if touch.direction_in(task)] == ["playing"]
    assert ranked["playing"] is touch
