import pytest

from minitouch_bench.errors import UsageError
from minitouch_bench.regression.settings import (
    DEFAULT_TOLERANCES,
    OTHER_TOLERANCE,
    STANDARD,
    GateFlags,
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
metric = "episode_steps"
tolerance = "15 %"
strict = true
"""


def read(tmp_path, text):
    file = tmp_path / "minitouch-bench.toml"
    file.write_text(text)
    return read_settings(file)


def test_a_file_sets_level_metric_and_tolerance(tmp_path):
    settings = read(tmp_path, GOOD)
    wanted = GateSettings(0.01, "episode_steps", Tolerance(0.15, relative=True), strict=True)
    assert settings == wanted
    assert settings.tolerance_of("episode_steps") == Tolerance(0.15, relative=True)
    assert read(tmp_path, "[regress]\ntolerance = 0.1\n").tolerance == Tolerance(0.1)


def test_a_metric_has_its_default_tolerance():
    for metric in ("success", "episode_steps"):
        assert STANDARD.tolerance_of(metric) == DEFAULT_TOLERANCES[metric]
    assert STANDARD.tolerance_of("touch_share") == OTHER_TOLERANCE


def test_a_file_without_our_table_changes_nothing(tmp_path):
    assert read(tmp_path, "[other]\nx = 1\n") == GateSettings()


BAD = [
    ("[regress]\nalhpa = 0.1", "no key 'alhpa'"),
    ("[regress]\nmetrics = ['success']", "no key 'metrics'"),
    ("[regress.tolerance]\nsuccess = 0.1", "tolerance: expected"),
    ("[regress]\ntolerance = 1.5", "from 0 to below 1"),
    ("[regress]\ntolerance = -0.1", "from 0 to below 1"),
    ("[regress]\nmetric = 'episode_steps'\ntolerance = nan", "0 or more"),
    ("[regress]\ntolerance = 'much'", "one number, or a percentage"),
    ("[regress]\ntolerance = true", "tolerance: expected"),
    ("[regress]\ntolerance = '150%'", "from 0 to below 1"),
    ("[regress]\nalpha = 0.7", "between 0 and 0.5"),
    ("[regress]\nalpha = 'a'", "alpha: expected"),
    ("[regress]\nmetric = 'return'", "no metric 'return'"),
    ("[regress]\nmetric = 3", "metric: expected"),
    ("[regress]\nstrict = 1", "strict: expected"),
    ("[regress]\nstrict = true\nlenient = true", "not both"),
    ("regress = 3", "expected object, got int"),
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
    settings = read(tmp_path, GOOD)
    flags = GateFlags(alpha=0.1, tolerance="5%", lenient=True)
    wanted = GateSettings(0.1, "episode_steps", Tolerance(0.05, relative=True), lenient=True)
    assert with_flags(settings, flags) == wanted
    assert with_flags(settings, GateFlags()) == settings
    assert with_flags(GateSettings(), GateFlags(strict=True)).strict
    steps = GateFlags(metric="episode_steps", tolerance="3")
    assert with_flags(GateSettings(), steps) == GateSettings(
        metric="episode_steps", tolerance=Tolerance(3)
    )


@pytest.mark.parametrize(
    "flags",
    [
        {"tolerance": ""},
        {"tolerance": "success=0.1"},
        {"tolerance": "1"},
        {"metric": "flying"},
        {"alpha": 0.0},
        {"strict": True, "lenient": True},
    ],
)
def test_a_flag_without_meaning_is_refused(flags):
    with pytest.raises(UsageError):
        with_flags(GateSettings(), GateFlags(**flags))


def test_a_relative_tolerance_is_of_the_baseline_s_mean():
    assert Tolerance(0.1, relative=True).absolute(40.0) == 4.0
    assert Tolerance(0.1).absolute(40.0) == 0.1
    assert [str(Tolerance(0.1, relative=True)), str(Tolerance(0.05))] == ["10%", "0.05"]
