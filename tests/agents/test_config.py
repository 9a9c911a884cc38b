import math
import re
import tomllib
from dataclasses import replace

import pytest
import torch
from torch import nn

from minitouch_bench.agents.config import PRESETS, PhaseConfig, make_config
from minitouch_bench.agents.sac import Sac
from minitouch_bench.errors import UsageError
from minitouch_bench.json_io import write_toml
from tests.altered import ROOT


@pytest.mark.parametrize("preset", PRESETS)
def test_a_file_of_settings_is_read_back_whole_and_serves_another_task(tmp_path, preset):
    config = replace(PRESETS[preset]("opening"), seed=3, method="rnd", dataset="Ä\U0001f600")
    file = tmp_path / "config.toml"
    file.write_text(write_toml(config))
    assert make_config("opening", file=file) == config
    assert make_config("pushing", file=file) == replace(config, task="pushing")


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path):
    file = tmp_path / "config.toml"
    file.write_text("seed = 5\n[sac]\nshift = 0\ndiscount = 1\n")
    base = make_config("pushing")
    sac = replace(base.sac, shift=0, discount=1.0)
    assert make_config("pushing", file=file) == replace(base, seed=5, sac=sac)
    later = make_config("pushing", file=file, settings={"seed": 6})
    assert later == replace(base, seed=6, sac=sac)


@pytest.mark.parametrize("page", ["how-to/configure-a-training", "reference/training-settings"])
def test_the_settings_that_the_pages_show_are_settings(tmp_path, page):
    blocks = re.findall(r"```toml\n(.*?)```", (ROOT / f"docs/{page}.md").read_text(), re.DOTALL)
    assert blocks
    for block in blocks:
        (tmp_path / "settings.toml").write_text(block)
        assert make_config("pushing", file=tmp_path / "settings.toml") != make_config("pushing")


def test_senses_are_in_one_order_however_they_are_written():
    phase = PhaseConfig(10, without=("vision", "forces", "vision"))
    assert phase == PhaseConfig(10, without=("forces", "vision"))
    twice = make_config("opening", settings={"task_phase": {"without": ["forces", "forces"]}})
    assert twice.task_phase.without == ("forces",)


def test_the_target_entropy_falls_evenly_and_then_stays():
    phase = PhaseConfig(100, target_entropy=0.0, final_target_entropy=-3.0, entropy_steps=60)
    assert [phase.target_entropy_at(step) for step in (0, 20, 60, 100)] == [0.0, -1.0, -3.0, -3.0]
    assert replace(phase, entropy_steps=0).target_entropy_at(100) == 0.0


@pytest.mark.parametrize("preset", PRESETS)
def test_a_training_is_as_long_as_in_the_study_of_touch(preset):
    design = tomllib.loads((ROOT / "experiments" / "touch" / "design.toml").read_text())
    for task, grid in design["per_task"].items():
        ours = make_config(task, preset)
        assert [ours.exploration.steps] == grid["exploration_steps"]
        assert ours.task_phase.steps == grid.get("task_steps", 0)


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"evaluate_episodes": 10**12}, "evaluate_episodes"),
        ({"seed": 2**64}, "seed"),
        ({"exploration": {"updates_per_step": math.nan}}, "updates_per_step"),
        ({"sac": {"batch_size": 0}}, "batch_size"),
        ({"episode_steps": 2000}, "episode_steps"),
        ({"sac": {"batch": 1}}, "batch"),
        ({"seed": "x"}, "seed"),
        ({"method": "ddpg"}, "ddpg"),
    ],
)
def test_a_setting_that_there_is_not_or_out_of_its_range_is_named(settings, word):
    with pytest.raises(UsageError, match=word):
        make_config("pushing", settings=settings)


def test_an_unknown_task_or_preset_and_a_file_of_something_else_are_named(tmp_path):
    (tmp_path / "config.toml").write_text("seed = ")
    wrong = (("juggling",), ("pushing", "best"), ("pushing", "paper", tmp_path / "config.toml"))
    for arguments, word in zip(wrong, ("juggling", "best", "TOML"), strict=True):
        with pytest.raises(UsageError, match=word):
            make_config(*arguments)


def test_the_paper_preset_is_table_2():
    config = PRESETS["paper"]("pushing")
    for phase in (config.exploration, config.task_phase):
        assert phase.learning_rate == 3e-5
        assert phase.reward_scale == 100
    assert (config.sac.batch_size, config.sac.discount) == (128, 0.99)
    assert config.replay_size == 10**6
    sac = Sac(config.sac, action_size=4)
    sac.begin_phase(config.task_phase)
    assert {type(one) for one in sac.optimizers.values()} == {torch.optim.Adam}
    hidden = [(nn.Linear, 128), (nn.LeakyReLU, 0)] * 2
    critic = sac.critics.first[:-1]  # the last layer gives the value
    for layers in (sac.actor.trunk, critic):
        assert [(type(one), getattr(one, "out_features", 0)) for one in layers] == hidden


def test_a_task_phase_that_has_not_begun_can_have_other_senses():
    def config(steps, *senses):
        return make_config("opening", settings={"task_phase": {"steps": steps, "without": senses}})

    assert config(10, "vision").is_longer_than(config(0))
    assert config(20, "vision").is_longer_than(config(10, "vision"))
    assert not config(20, "vision").is_longer_than(config(10))
