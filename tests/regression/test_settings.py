import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.regression.settings import (
    DEFAULT_TOLERANCES,
    OTHER_TOLERANCE,
    GateSettings,
    Tolerance,
    read_settings,
    with_flags,
)

GOOD = """
[tool.other]
kept = "for others"
[regress]
alpha = 0.01
strict = true
metrics = ["touch_interaction", "success"]
[regress.tolerance]
success = 0.1
touch_share = "50 %"
pushing.success = 0.02
mean.success = 0.03
[regress.tolerance.playing]
touch_interaction = 40
"""


def read(tmp_path, text):
    file = tmp_path / "minitouch-bench.toml"
    file.write_text(text)
    return read_settings(file)


def test_a_file_sets_levels_metrics_and_tolerances(tmp_path):
    settings = read(tmp_path, GOOD)
    assert (settings.alpha, settings.strict) == (0.01, True)
    assert settings.metrics == ("success", "touch_interaction")
    assert settings.tolerance("opening", "success") == Tolerance(0.1)
    assert settings.tolerance("pushing", "success") == Tolerance(0.02)
    assert settings.tolerance("mean", "success") == Tolerance(0.03)
    assert settings.tolerance("opening", "touch_share") == Tolerance(0.5, relative=True)
    assert settings.tolerance("playing", "touch_interaction") == Tolerance(40)
    assert GateSettings().tolerance("playing", "touch_interaction") == OTHER_TOLERANCE
    assert settings.tolerance("opening", "episode_steps") == DEFAULT_TOLERANCES["episode_steps"]


def test_a_file_without_our_table_changes_nothing(tmp_path):
    assert read(tmp_path, "[other]\nx = 1\n") == GateSettings()


BAD = [
    ("[regress]\nalhpa = 0.1", "no key 'alhpa'"),
    ("[regress.tolerance]\nsucces = 0.1", "no key 'succes'"),
    ("[regress.tolerance.flying]\nsuccess = 0.1", "no key 'flying'"),
    ("[regress.tolerance.pushing]\nsteps = 0.1", "no key 'steps'"),
    ("[regress.tolerance.playing]\nsuccess = 0.1", "playing has no success"),
    ("[regress.tolerance.mean]\nepisode_steps = 0.1", "mean has no episode_steps"),
    ("[regress.tolerance.pushing]\ntouch_interaction = 9", "neither better nor worse in pushing"),
    ("[regress.tolerance]\nsuccess = 1.5", "from 0 to below 1"),
    ("[regress.tolerance]\nsuccess = -0.1", "from 0 to below 1"),
    ("[regress.tolerance]\nepisode_steps = nan", "0 or more"),
    ("[regress.tolerance]\nsuccess = 'much'", "number or a percentage"),
    ("[regress.tolerance]\nsuccess = true", "number or a percentage"),
    ("[regress.tolerance]\nsuccess = '150%'", "from 0 to below 1"),
    ("[regress]\nalpha = 0.7", "between 0 and 0.5"),
    ("[regress]\nalpha = 'a'", "between 0 and 0.5"),
    ("[regress]\nmetrics = ['return']", "no metric 'return'"),
    ("[regress]\nmetrics = []", "list of some of"),
    ("[regress]\nstrict = 1", "true or false"),
    ("[regress]\ntolerance = 3", "is a table"),
    ("regress = 3", "is a table"),
    ("[regress", "not TOML"),
]


@pytest.mark.parametrize(("text", "reason"), BAD)
def test_what_is_unknown_or_has_no_meaning_is_named(tmp_path, text, reason):
    with pytest.raises(UsageError, match=reason) as refusal:
        read(tmp_path, text)
    assert "minitouch-bench.toml" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(UsageError, match="cannot be read"):
        read_settings(tmp_path / "gone.toml")


def test_flags_go_before_the_file(tmp_path):
    flags = ["success=0.2", "pushing.success = 5%"]
    settings = with_flags(read(tmp_path, GOOD), flags, alpha=0.1, metrics="success, episode_steps")
    assert (settings.alpha, settings.strict) == (0.1, True)
    assert settings.metrics == ("success", "episode_steps")
    assert settings.tolerance("opening", "success") == Tolerance(0.2)
    assert settings.tolerance("pushing", "success") == Tolerance(0.05, relative=True)
    assert with_flags(GateSettings(), [], strict=True).strict


@pytest.mark.parametrize(
    "flag", ["success", "success=", "=0.1", "flying.success=0.1", "playing.success=0", "a.b=1"]
)
def test_a_flag_without_meaning_is_refused(flag):
    with pytest.raises(UsageError):
        with_flags(GateSettings(), [flag])


def test_a_relative_tolerance_is_of_the_baseline_s_mean():
    assert Tolerance(0.1, relative=True).absolute(40.0) == 4.0
    assert Tolerance(0.1).absolute(40.0) == 0.1
    assert [str(Tolerance(0.1, relative=True)), str(Tolerance(0.05))] == ["10%", "0.05"]
