"""Make ``report.md`` and the figures of an experiment from its CSV files.

The same files give the same bytes. Run ``python -m experiments.analysis`` for the stored studies,
or name the design file and the directory of another experiment.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.figures import write_figures
from experiments.grid import KEY, cells_of, check_lock, default_output, read_design
from experiments.played import played_rows
from experiments.reliance import WORDS
from minitouch_bench.leaderboard.ranking import FLOOR_SUCCESS
from minitouch_bench.metrics.definitions import METRICS, ShownIn, metrics_shown_in, ranking_metric
from minitouch_bench.metrics.intervals import OVER_SEEDS, Estimate, over_seeds
from minitouch_bench.metrics.statistics import count_discordance, tango
from minitouch_bench.reporting.labels import (
    MARK_NOTE,
    PAPER_METHODS,
    PAPER_NOTE,
    paper_cell,
    task_title,
)

STUDIES = Path(__file__).parent
"""Where each study has a folder: ``design.toml``, and once it is trained rows, report, figures."""

POINT = ["task", "exploration_steps", "method", "suite", "conditions", "metric"]
"""What has one value per training seed."""

ESTIMATE = ["value", "low", "high", "episodes", "interval"]
GAP, CHANGE = ", held-out minus train", ", change"
"""What follows a metric's name where the value is a difference."""

TABLE4 = (*metrics_shown_in(ShownIn.TABLE4), "steps_to_success")
"""Table 4, and the steps of successful episodes: its episode steps count a failure as 200."""
COMPARED = ("success", "touch_share", "episode_steps")
"""What Figure 11 compares between train shapes and held-out ones."""

ABSENT = "—"

SEEDS_NOTE = (
    f"95 % intervals: {OVER_SEEDS}. They describe training seeds on the suite's scenes. Where few "
    "seeds fail and others succeed they are too narrow. With one training seed they are over "
    "episodes only. Learned: the lower end of a seed's interval of success is above the success of "
    "the best policy that learned nothing."
)
EPISODES_NOTE = "95 % intervals of the episodes of each training seed's policy."
CONDITIONS_NOTE = (
    "Without a sense: it stays as it is at the reset, which the policy's own training does not "
    "contain. Change: the value less that of the same policy in the same episodes under standard "
    "conditions, paired by episode."
)


@dataclass(frozen=True)
class Results:
    """What an experiment shows: its report and all values.

    ``joined`` has a row per ``POINT`` with its estimate over training seeds.
    """

    report: str
    joined: pd.DataFrame


def stored_studies() -> list[Path]:
    """Return the folders of the studies that have rows."""
    return sorted(file.parent for file in STUDIES.glob("*/trainings.csv"))


def write_results(design: Mapping[str, Any], directory: Path) -> None:
    """Write ``report.md`` and the figures of an experiment into its directory."""
    results = analyze(design, directory)
    (directory / "report.md").write_text(results.report, encoding="utf-8")
    curves, episodes = (read_rows(directory, name) for name in ("curves", "episodes"))
    if len(curves):
        write_figures(results.joined, episodes, curves, directory / "figures")


def read_rows(directory: Path, name: str) -> pd.DataFrame:
    """Read one of the CSV files of an experiment; NaN only in the curves.

    Episodes and estimates that are not there are those of the leaderboard.
    """
    file = directory / f"{name}.csv"
    if not (directory / "trainings.csv").exists():
        sys.exit(f"no training is finished in {directory}")
    if name in ("episodes", "estimates") and not file.exists():
        return played_rows(directory)[name]
    return pd.read_csv(file, keep_default_na=name == "curves")


def analyze(design: Mapping[str, Any], directory: Path) -> Results:
    """Make the results of an experiment from its CSV files.

    Args:
        design: The content of its design file.
        directory: Where the CSV files are.
    """
    estimates, episodes = (read_rows(directory, name) for name in ("estimates", "episodes"))
    changes = changes_of(episodes)
    joined = join_seeds(pd.concat([estimates[estimates["metric"].map(_is_shown)], changes]))
    state = f"{len(estimates[KEY].drop_duplicates())} of {len(cells_of(design))} trainings"
    title = design.get("title", f"Study {directory.resolve().name}")
    lines = [
        f"# {title}",
        "",
        f"{state} are done and evaluated. {design.get('about', '')}".rstrip(),
    ]
    gaps = [name for name in dict.fromkeys(joined["metric"]) if name.endswith(GAP)]
    for section in (
        _over_seeds("Table 4", joined, "table4", TABLE4, learned_seeds(estimates)),
        _over_seeds("Novel shapes", joined, "novel-shapes", gaps, {}),
        _training_seeds(estimates),
        _conditions(joined, episodes),
    ):
        lines += section
    return Results("\n".join(lines) + "\n", joined)


def _is_shown(metric: str) -> bool:
    name, _, split = metric.partition(", ")
    return metric in TABLE4 or metric.endswith(GAP) or (bool(split) and name in COMPARED)


def join_seeds(estimates: pd.DataFrame) -> pd.DataFrame:
    """Return a row per ``POINT`` with its estimate over training seeds, in order of appearance."""
    rows = []
    for point, group in estimates.groupby(POINT, sort=False):
        task, metric = str(point[0]), str(point[-1])
        of_seeds = [Estimate(*row) for row in group[ESTIMATE].itertuples(index=False, name=None)]
        name, is_difference = metric.partition(",")[0], metric.endswith((GAP, CHANGE))
        possible = METRICS[name].range_in(task, difference=is_difference)
        rows.append((*point, *astuple(over_seeds(of_seeds, possible))))
    return pd.DataFrame(rows, columns=[*POINT, *ESTIMATE])


def changes_of(episodes: pd.DataFrame) -> pd.DataFrame:
    """Return what other conditions change of each policy's success, in the same episodes."""
    main = episodes[(episodes["role"] == "final") & (episodes["suite"] == "table4")]
    standard = main[main["conditions"] == ""].set_index([*KEY, "index"])["success"]
    rows = []
    others = main[main["conditions"] != ""].groupby([*KEY, "conditions"], sort=False)
    for (*cell, conditions), group in others:
        index = pd.MultiIndex.from_frame(group[[*KEY, "index"]])
        if not (in_both := index.isin(standard.index)).any():
            continue
        pair = (
            won.to_numpy(float) for won in (standard[index[in_both]], group["success"][in_both])
        )
        named = (*cell, "table4", conditions, f"success{CHANGE}")
        rows.append((*named, *astuple(tango(*count_discordance(*pair)))))
    return pd.DataFrame(rows, columns=[*KEY, "suite", "conditions", "metric", *ESTIMATE])


# Tables


def value_text(metric: str, value: float, sign: str = "") -> str:
    """Write a value of a metric with the digits it deserves."""
    return format(value, sign + METRICS[metric].number_format)


def estimate_text(rows: pd.DataFrame) -> str:
    """Write the estimate of a frame's only row with its interval, a dash for no row."""
    if rows.empty:
        return ABSENT
    metric = str(rows["metric"].iloc[0])
    sign = "+z" if metric.endswith((GAP, CHANGE)) else ""
    ends = (rows[end].iloc[0] for end in ("value", "low", "high"))
    value, low, high = (value_text(metric.partition(",")[0], end, sign) for end in ends)
    return f"{value} [{low}, {high}]"


def table_lines(heads: Sequence[str], rows: Sequence[Sequence[str]], words: int = 1) -> list[str]:
    """Return a table in Markdown; the first ``words`` columns are of words."""
    ruler = ["---"] * words + ["---:"] * (len(heads) - words)
    return ["", *(f"| {' | '.join(row)} |" for row in (heads, ruler, *rows))]


def _notes(*notes: str) -> list[str]:
    return ["", *(f"- {note}" for note in notes)]


PICTURES = {
    "curves": "Learning curves: means over training seeds, with their 95 % intervals or, of fewer "
    "than five seeds, with each seed's curve (thin)",
    "movement": "Touch share and object movement at the end of exploration: a dot per training, "
    "crosses of means over training seeds with their 95 % intervals",
    "lengths": "Each length of exploration",
    "novel-shapes": "Train shapes and held-out shapes",
    "conditions": "The standard and the other conditions",
}


def _pictures(*names: str) -> Iterator[str]:
    for name in names:
        yield from ("", f"![{PICTURES[name]}](figures/{name}.svg)")


def _title(point: Sequence[Any]) -> str:
    task, steps = point
    return f"{task_title(task)}, {steps:,} control steps of exploration"


def learned_seeds(estimates: pd.DataFrame) -> dict[tuple[Any, ...], str]:
    """Return by task, length of exploration and method how many training seeds learned."""
    success = estimates[estimates["metric"] == "success"]
    main = success[(success["suite"] == "table4") & (success["conditions"] == "")]
    above = main.assign(above=main["low"] > main["task"].map(FLOOR_SUCCESS))
    counts = above.groupby(["task", "exploration_steps", "method"])["above"].agg(["sum", "size"])
    return {point: f"{row['sum']} of {row['size']}" for point, row in counts.iterrows()}


def _over_seeds(
    title: str,
    joined: pd.DataFrame,
    suite: str,
    metrics: Sequence[str],
    learned: Mapping[tuple[Any, ...], str],
) -> Iterator[str]:
    """Yield a table per task and length of exploration, with a column per method."""
    part = joined[(joined["suite"] == suite) & (joined["conditions"] == "")]
    part = part[part["metric"].isin(metrics)]
    with_paper = suite == "table4"
    if len(part):
        yield from ("", f"## {title}")
    for point, group in part.groupby(["task", "exploration_steps"], sort=False):
        task, methods = str(point[0]), [*dict.fromkeys(group["method"])]
        paper = PAPER_METHODS if with_paper else ()
        rows = []
        for metric in (one for one in metrics if one in {*group["metric"]}):
            known, comma, suffix = metric.partition(",")
            name = f"{METRICS[known].label} {METRICS[known].direction_in(task)}".strip()
            found = group[group["metric"] == metric]
            cells = [estimate_text(found[found["method"] == method]) for method in methods]
            cells += [paper_cell(task, metric, method).text for method in paper]
            rows.append([f"{name}{comma}{suffix}<br>{METRICS[known].unit_in(task)}", *cells])
        counts = [learned.get((*point, method), ABSENT) for method in methods]
        if set(counts) != {ABSENT}:
            rows.append(["Learned<br>training seeds", *counts, *[ABSENT] * len(paper)])
        yield from ("", f"### {_title(point)}")
        yield from table_lines(["Metric", *methods, *(f"{one} (paper)" for one in paper)], rows)
    if len(part):
        yield from _notes(SEEDS_NOTE, *([f"{PAPER_NOTE} {MARK_NOTE}"] if with_paper else []))
        yield from _pictures(*(("curves", "movement") if with_paper else ("novel-shapes",)))
    if with_paper and part.groupby("task")["exploration_steps"].nunique().max() > 1:
        yield from _pictures("lengths")


def _training_seeds(estimates: pd.DataFrame) -> Iterator[str]:
    """Yield the table of each training seed: exploration, and what ranks the task."""
    main = estimates[(estimates["suite"] == "table4") & (estimates["conditions"] == "")]
    ranks = main["metric"] == main["task"].map(ranking_metric)
    part = main[ranks | (main["metric"] == "exploration")].sort_values("metric", kind="stable")
    seeds = sorted({*part["training_seed"]})
    rows = []
    names = ["metric", "task", "method", "exploration_steps"]
    for (metric, task, method, steps), group in part.groupby(names, sort=False):
        cells = [estimate_text(group[group["training_seed"] == seed]) for seed in seeds]
        rows.append([METRICS[metric].label, task_title(task), method, f"{steps:,}", *cells])
    yield from ("", "## Training seeds")
    heads = ["Metric", "Task", "Method", "Exploration, control steps"]
    yield from table_lines([*heads, *(f"seed {seed}" for seed in seeds)], rows, len(heads))
    yield from _notes(EPISODES_NOTE)


def _conditions(joined: pd.DataFrame, episodes: pd.DataFrame) -> Iterator[str]:
    """Yield the table of what ranks a task under each condition, and what the condition changes."""
    main = joined[joined["suite"] == "table4"]
    changed = main[main["conditions"] != ""]
    is_played = main["task"].isin(changed["task"]) & main["method"].isin(changed["method"])
    ranks = main["metric"].str.removesuffix(CHANGE) == main["task"].map(ranking_metric)
    shown = main[is_played & ranks]
    methods = [*dict.fromkeys(shown["method"])]
    rows = []
    for (task, conditions), _ in shown.groupby(["task", "conditions"], sort=False):
        of_both = shown[(shown["task"] == task) & (shown["conditions"] == conditions)]
        for metric, group in of_both.groupby("metric", sort=False):
            label = str(metric).replace("success", METRICS["success"].label)
            cells = [estimate_text(group[group["method"] == method]) for method in methods]
            rows.append([task_title(str(task)), str(conditions) or "standard", label, *cells])
    if rows:
        yield from ("", "## Other conditions")
        yield from table_lines(["Task", "Condition", "Metric", *methods], rows, 3)
        standard = "The standard row is of all episodes."
        yield from _notes(f"{CONDITIONS_NOTE} {standard}", *silent_note(episodes), SEEDS_NOTE)
        yield from _pictures("conditions")


def silent_note(episodes: pd.DataFrame) -> Iterator[str]:
    """Say how often the forces of another episode had ended, if there are such rows."""
    main = episodes[(episodes["role"] == "final") & (episodes["suite"] == "table4")]
    lengths = main[main["conditions"] == ""].set_index([*KEY, "index"])["steps"]
    others = main[main["conditions"] == WORDS["other"]]
    if others.empty:
        return
    count = others["index"].max() + 1
    before = others[[*KEY, "index"]].assign(index=(others["index"] - 1) % count)
    donors = lengths[pd.MultiIndex.from_frame(before)].to_numpy()
    silent = (others["steps"] - donors).clip(lower=0)
    methods = others["method"]
    shares = (silent.groupby(methods).sum() / others["steps"].groupby(methods).sum()).items()
    yield (
        "Forces of another episode: those that the policy felt in the same control step of the "
        "episode before. After the end of that episode they are 0 N, which the policy otherwise "
        "feels at a reset alone (a finger in free air reads 1.0 N). Share of the control steps in "
        f"which this is so: {', '.join(f'`{method}` {share:.2f}' for method, share in shares)}."
    )


def main() -> None:
    """Write the reports of the stored studies, or of one experiment."""
    parser = argparse.ArgumentParser(prog="python -m experiments.analysis", description=__doc__)
    parser.add_argument("design", type=Path, nargs="?")
    parser.add_argument("directory", type=Path, nargs="?", help="default: reports/studies/NAME")
    given = parser.parse_args()
    if given.design is None:
        pairs = [(folder / "design.toml", folder) for folder in stored_studies()]
    else:
        pairs = [(given.design, given.directory or default_output(given.design))]
    for file, directory in pairs:
        design = read_design(file)
        check_lock(design, directory)
        write_results(design, directory)


if __name__ == "__main__":
    main()
