"""What the pages say: how much, of which commands and options, and with which numbers."""

import json
import re
import shlex
from itertools import product

import pytest
from typer.main import get_command

from experiments.analysis import ABSENT, STUDIES, join_seeds, learned_seeds, read_rows
from experiments.light.analysis import success_over_seeds
from experiments.senses import POLICIES
from minitouch_bench.commands.app import app
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.protocol.minitouch import GOAL_TASKS
from minitouch_bench.reporting.labels import task_title
from tests.altered import DOCS, ROOT

PARTS = ("", "start", "how-to", "explanation", "results")
USER_PAGES = [page for part in PARTS for page in (DOCS / part).glob("*.md")]
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md"), *ROOT.glob("experiments/*.md")])
WORDS = 12_500
METHODS = {
    "hac": "HaC", "rnd-touch": "RND+touch", "rnd": "RND", "icm": "ICM", "icm-touch": "ICM+touch",
    "disagreement": "Disagreement", "sac": "SAC",
}  # fmt: skip
ENDS = ("value", "low", "high")
SHELL = re.compile(r"^( *)```sh\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
PROGRAM = get_command(app)
INLINE = re.compile(rf"`(?:minitouch-bench )?((?:{'|'.join(PROGRAM.commands)})(?: [^`]+)?)`")
OTHER_TOOLS = re.compile(r"(?:--num-cpus|--policy\.path|--user|--userns)\b")


def test_the_user_pages_stay_short():
    assert len(USER_PAGES) > 25
    assert sum(len(page.read_text(encoding="utf-8").split()) for page in USER_PAGES) <= WORDS


@pytest.mark.parametrize(("study", "page", "with_playing"), [
    ("methods", "docs/results/reproduction.md", True),
    ("methods", "README.md", False),
])  # fmt: skip
def test_the_tables_of_results_follow_from_the_stored_rows(study, page, with_playing):
    estimates = read_rows(STUDIES / study, "estimates")
    main = estimates[(estimates["suite"] == "table4") & (estimates["conditions"] == "")]
    joined = join_seeds(main).set_index(["metric", "method", "task"])
    success, touch_share = joined.loc["success"], joined.loc["touch_share"]
    learned = {(task, name): count for (task, _, name), count in learned_seeds(estimates).items()}
    for method in METHODS.keys() & {*success.index.get_level_values("method")}:
        cells = [
            f"{estimate(success.loc[method, task])}, {learned[task, method]}"
            for task in ("pushing", "opening", "pick-up")
        ]
        if with_playing:
            cells.append(estimate(touch_share.loc[method, "playing"]))
        line = f"| {METHODS[method]} | {' | '.join(cells)} |"
        assert line in (ROOT / page).read_text(encoding="utf-8").splitlines()


def test_the_pages_have_what_the_study_of_light_found():
    joined = success_over_seeds(STUDIES / "light").set_index(["suite", "method"])
    page = (ROOT / "docs/results/reproduction.md").read_text(encoding="utf-8")
    for suite, name in (("table4", "light on"), ("dark", "light off")):
        of_suite = [one for one in POLICIES if (suite, one) in joined.index]
        cells = [estimate(joined.loc[(suite, one)]) for one in of_suite]
        assert f"| {' | '.join([name, *[ABSENT] * (4 - len(cells)), *cells])} |" in page
    line = (STUDIES / "touch" / "touch.md").read_text(encoding="utf-8").splitlines()[2]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert line.removeprefix("1. ").replace("**", "") in " ".join(readme.split())


def test_the_page_has_what_novel_shapes_change():
    board = json.loads((ROOT / "reports/leaderboard/leaderboard.json").read_text())
    (hac,) = (row for row in board["ranked"] if row["name"] == "hac")
    page = " ".join((ROOT / "docs/results/reproduction.md").read_text(encoding="utf-8").split())
    for task, gap in hac["novel_shapes"].items():
        values = (f"{gap[split]['value']:.3f}" for split in ("held_out", "train"))
        assert f"{task_title(task)} {' and '.join(values)}" in page


def test_the_board_has_the_values_of_the_study_of_every_method():
    estimates = read_rows(STUDIES / "methods", "estimates")
    main = estimates[(estimates["suite"] == "table4") & (estimates["conditions"] == "")]
    studied = join_seeds(main).set_index(["method", "task", "metric"])
    board = json.loads((ROOT / "reports/leaderboard/leaderboard.json").read_text())
    rows = [row for row in board["ranked"] if row["name"] in METHODS]
    assert {row["name"] for row in rows} == {*studied.index.get_level_values("method")}
    for row in rows:
        for task, metric in [*product(GOAL_TASKS, ["success", "exploration", "episode_steps"]),
                             ("playing", "touch_share")]:  # fmt: skip
            if metric not in row["figures"][task]:  # sac does not explore
                assert (row["name"], task, metric) not in studied.index
                continue
            shown, value = row["figures"][task][metric], studied.loc[row["name"], task, metric]
            assert [shown[end] for end in ENDS] == pytest.approx([value[end] for end in ENDS])


def estimate(row):
    return f"{row.value:.3f} [{row.low:.3f}, {row.high:.3f}]"


def test_the_page_of_metrics_has_every_metric():
    page = (DOCS / "reference" / "metrics.md").read_text(encoding="utf-8")
    assert not [name for name, one in METRICS.items() if f"| {one.label} | `{name}` |" not in page]


def test_every_command_on_a_page_has_the_options_that_it_shows():
    shown = [(page.name, line) for page in PAGES for line in commands_on(page)]
    assert len(shown) > 150
    assert not [(page, line, bad) for page, line in shown if (bad := unknown(line))]


def test_every_option_that_a_page_names_is_one_of_a_command():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    named = {name for name in re.findall(r"`(--[\w.-]+)", text) if not OTHER_TOOLS.match(name)}
    assert len(named) > 40
    assert not named - {name for command in commands() for name in options_of(command)}


def commands_on(page):
    """Yield the commands of a page's shell blocks, and those in its text, from the verb on."""
    text = page.read_text(encoding="utf-8")
    for _, block in SHELL.findall(text):
        for line in block.replace("\\\n", " ").splitlines():
            yield from re.findall(r"minitouch-bench (\w.*)", line)
    yield from INLINE.findall(re.sub(r"^ *```.*?^ *```", "", text, flags=re.M | re.S))


def unknown(line):
    """Return what the program does not have of a command's name and options."""
    words, command = shlex.split(line, comments=True), PROGRAM
    while words and hasattr(command, "commands"):
        if words[0] not in command.commands:
            return words[:1]
        command = command.commands[words.pop(0)]
    given = {word.partition("=")[0] for word in words if re.fullmatch(r"--[a-z][\w-]*(=.*)?", word)}
    return sorted(given - options_of(command))


def commands(command=PROGRAM):
    yield command
    for one in getattr(command, "commands", {}).values():
        yield from commands(one)


def options_of(command):
    names = (name for one in command.params for name in (*one.opts, *one.secondary_opts))
    return {*names, "--help"}
