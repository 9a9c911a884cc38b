import re

import pandas as pd

from minitouch_bench.reporting.training_page import EPISODES, episode_success, training_page


def test_hostile_settings_are_only_text_and_a_single_evaluation_is_drawn(tmp_path):
    hostile = 'task = "pushing"\nmethod = "<script>x"\nseed = 7\nlog = "<script>x"\n'
    (tmp_path / "config.toml").write_text(hostile)
    names = "step,phase,episodes,success,touch_share,force,seconds,evaluation_touch_share"
    rows = "500,task,5,0.2,0.1,4.0,50,\n1000,task,5,0.2,0.1,4.0,50,0.5\n"
    (tmp_path / "progress.csv").write_text(f"{names}\n{rows}")
    page = training_page(tmp_path)
    assert "&lt;script&gt;x" in page
    assert "<script>x" not in page
    (drawing,) = re.findall(r'<svg[^>]*aria-label="Touch share over.*?</svg>', page)
    assert re.search('<path class="spots series-1"[^>]* d="M[0-9.]+ 60h0"', drawing)  # half of 112


def test_success_is_that_of_the_latest_episodes():
    rows = pd.DataFrame({"episodes": [10, 10, 10, 10], "success": [0.0, 1.0, 1.0, 0.5]})
    found = episode_success(rows)
    assert EPISODES == 20
    assert found.isna().tolist() == [True, False, False, False]
    assert found.tolist()[1:] == [0.5, 1.0, 0.75]
