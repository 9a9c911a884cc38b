"""From submissions and their results to the files of the leaderboard and its static site.

The site is an index and a page per row, each complete in itself. Results alone are shown.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

from minitouch_bench import files
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import write_file
from minitouch_bench.json_io import write_json
from minitouch_bench.leaderboard import board_tables
from minitouch_bench.leaderboard.board import (
    COLUMN_SPECS,
    FORMAT,
    TOUCH_METRICS,
    Board,
    BoardRow,
    LeftOut,
    make_board,
)
from minitouch_bench.leaderboard.fresh import FRESH_EPISODES
from minitouch_bench.leaderboard.play import Entry, PlayedRow
from minitouch_bench.leaderboard.ranking import (
    BOARD_GOALS,
    BOARD_TASKS,
    MEAN_OF,
    OVERALL,
    RANKED_BY,
    board_key,
)
from minitouch_bench.leaderboard.submission import (
    MODALITIES,
    check_submission,
    find_submissions,
)
from minitouch_bench.metrics.definitions import METRICS
from minitouch_bench.metrics.summary import TABLE4_METRICS
from minitouch_bench.protocol.minitouch import DARK, MAIN_SUITE, PROTOCOL
from minitouch_bench.reporting import labels, pages, tables
from minitouch_bench.reporting.charts import Figure
from minitouch_bench.reporting.figures import peak_figure, steps_figure, touch_figure
from minitouch_bench.reporting.labels import group_faults, task_title
from minitouch_bench.reporting.maps import MappedTask, start_figure
from minitouch_bench.reporting.report_tables import gap_cells
from minitouch_bench.reporting.tables import Row, Table
from minitouch_bench.runs.run import Run
from minitouch_bench.text import printable

BOARD_TEMPLATES = Path(__file__).parent / "templates"
STYLESHEETS = ("board.css",)

BOARD_FILE = "leaderboard.json"

PAGES, SITE_PICTURES = "submission", "pictures"
"""Directories of the rows' pages, and of the tasks' pictures, in the site."""


def build_board(submissions: Path, output: Path, results: Path = files.RESULTS) -> Board:
    """Rank the rows that were played, and write the leaderboard.

    What cannot be shown is named with its reason and does not stop the others.

    Raises:
        UsageError: there is no directory of submissions.
        RunDirectoryError: a file cannot be written, or ``output`` has files and is not a board.
    """
    if files.entries_of(output) and not _is_board(output):
        raise RunDirectoryError(f"{output} is not empty and not a leaderboard: choose another")
    played, waiting, left_out = read_rows(submissions, results)
    board = make_board(played, waiting, left_out)
    shown = board_tables.views(board)
    page_folder = files.make_folder(output / PAGES)
    write_file(output / "leaderboard.md", board_tables.board_markdown(board, shown))
    write_file(output / BOARD_FILE, write_json(board))
    write_file(output / "index.html", index_html(board, shown))
    rows = {row.name: row for row in board.rows}
    for one in played:
        row = rows[one.submission.name]
        page = submission_page(one, row, board)
        write_file(page_folder / f"{row.name}.html", page, durable=False)
    for path in page_folder.glob("*.html"):
        if path.stem not in rows and path.is_file() and not path.is_symlink():
            with files.os_errors_as(RunDirectoryError, path, "removed"):
                path.unlink()
    for task in BOARD_TASKS:
        picture = pages.PICTURES / f"{task}.png"
        write_file(output / SITE_PICTURES / picture.name, picture.read_bytes())
    return board


def _is_board(folder: Path) -> bool:
    """Tell whether a folder was written by ``build_board``."""
    file = folder / BOARD_FILE
    with files.os_errors_as(RunDirectoryError, file, "read"):
        return file.is_file() and f'"{FORMAT}"'.encode() in files.read_file(file)


def read_rows(
    submissions: Path, results: Path
) -> tuple[list[PlayedRow], list[LeftOut], list[LeftOut]]:
    """Return the rows that were played, the submissions that wait, and what cannot be shown.

    Raises:
        UsageError: there is no directory of submissions.
    """
    played, waiting, left_out = [], [], []
    names = set()
    for directory in find_submissions(submissions):
        name = directory.name
        names.add(name)
        if problem := next(check_submission(directory), ""):
            left_out.append(LeftOut(printable(name), printable(problem)))
            continue
        entry = Entry.open(directory, results)
        try:
            row = entry.read()
        except RunDirectoryError as error:
            left_out.append(LeftOut(name, f"{error}: minitouch-bench leaderboard play {name}"))
            continue
        if row.official:
            played.append(row)
        if missing := [suite for suite in entry.submission.suites if suite not in row.official]:
            command = f"minitouch-bench leaderboard play {name}"
            reason = row.row.waiting or f"not played yet; a maintainer plays it by {command}"
            waiting.append(LeftOut(name, f"{', '.join(missing)}: {reason}"))
    folders = find_submissions(results) if results.is_dir() else []
    alone = [folder.name for folder in folders if folder.name not in names]
    left_out += [LeftOut(printable(name), "results without a submission") for name in alone]
    return played, waiting, left_out


# The index


def index_html(board: Board, shown: Sequence[board_tables.BoardView]) -> str:
    """Write the index."""
    return pages.render_page(
        BOARD_TEMPLATES / "board.html.j2",
        STYLESHEETS,
        ("theme.js", "board.js"),
        board=board,
        views=shown,
        columns={name: column for name, column in COLUMN_SPECS.items() if column.place == "column"},
        beside={name: column for name, column in COLUMN_SPECS.items() if column.place == "name"},
        modalities={
            name: meaning
            for name, meaning in MODALITIES.items()
            if any(name in row.modalities for row in board.rows)
        },
        notes=board_tables.board_notes(),
        tasks=len(PROTOCOL.tasks),
    )


# The page of a row


def submission_page(played: PlayedRow, row: BoardRow, board: Board) -> str:
    """Write the page of a row of the ``board``."""
    path = f"{files.SUBMISSIONS}/{row.name}"
    policy = row.name if row.is_calibration else f"{path}/seed-{row.training_seeds[0]}"
    ranks = {key: f"rank {rank}" for key, rank in row.ranks.items()}
    main = played.official.get(MAIN_SUITE, ())
    rivals = sum(OVERALL in one.ranks for one in board.ranked)
    return pages.render_page(
        BOARD_TEMPLATES / "submission.html.j2",
        STYLESHEETS,
        ("theme.js", *(["episodes.js"] if main else [])),
        protocol=PROTOCOL.name,
        row=row,
        facts=COLUMN_SPECS,
        submission=played.submission,
        draws=played.row.draws,
        runs=[run for runs in played.official.values() for run in runs],
        checkpoint=policy,
        rank=f"{ranks[OVERALL]} of {rivals}" if OVERALL in ranks else "",
        why=[
            (_title(key), ranks[key], board_tables.explain_rank(board, row, key))
            for key in RANKED_BY
            if key in ranks
        ],
        cards=tuple(_card(row, task, ranks.get(task, "")) for task in BOARD_TASKS if main),
        values=_values(row, MAIN_SUITE, "All values") if main else None,
        dark=_values(row, DARK, "In the dark") if DARK in row.figures else None,
        trainings=_trainings(row, main) if len(main) > 1 else None,
        gaps=_gaps(row) if row.novel_shapes else None,
        fresh=_fresh(row),
        figures=submission_figures(played) if main else (),
        episodes=pages.browser_data([_browsed(row, run, path) for run in main]),
        faults=_faults(played.official),
    )


def _title(key: str) -> str:
    suite, _, task = key.rpartition("/")
    return f"{task_title(task)}, {suite}" if suite else task_title(task)


def _browsed(row: BoardRow, run: Run, path: str) -> pages.BrowsedRun:
    place = run.name.partition("/")[2]
    policy = row.name if row.is_calibration else f"{path}/{place.partition('/')[0]}"
    evaluate = shlex.join(["minitouch-bench", "evaluate", policy])
    return pages.BrowsedRun(place, replace(run, exploration_rows=()), evaluate=evaluate)


def _card(row: BoardRow, task: str, rank: str) -> pages.Card:
    card = pages.make_card(task, [(row.name, row.figures[task])], f"../pictures/{task}.png", rank)
    (value,) = card.values
    return replace(
        card, values=(replace(value, cell=board_tables.with_learned(value.cell, row, task)),)
    )


def _values(row: BoardRow, suite: str, title: str) -> Table:
    rows = []
    tasks = [task for task in BOARD_TASKS if task in PROTOCOL.suite(suite).tasks]
    keys = [board_key(suite, task) for task in tasks]
    for metric in (*TABLE4_METRICS, *TOUCH_METRICS):
        cells = (labels.estimate_cell(metric, row.estimate(key, metric)) for key in keys)
        head = (labels.metric_head(metric),)
        rows.append(Row(head, tuple(cells), unit=METRICS[metric].unit))
    note = f"{board_tables.EPISODE_VARIANCE[0].upper()}{board_tables.EPISODE_VARIANCE[1:]}."
    if len(row.training_seeds) > 1:
        learned = (row.learned_in(key).removesuffix(" seeds learned") for key in keys)
        rows.append(tables.make_row(("Learned, training seeds",), *learned))
        note = board_tables.SEED_VARIANCE
    return Table(
        title=title,
        corner=("Metric",),
        columns=tables.make_columns(*map(task_title, tasks)),
        rows=tuple(rows),
        notes=(f"Brackets: 95 % interval. {note}",),
    )


def _trainings(row: BoardRow, runs: Sequence[Run]) -> Table:
    """Lay out what ranks each task, and its exploration, by training seed."""
    wanted = [(task, RANKED_BY[task]) for task in BOARD_TASKS]
    wanted += [(task, "exploration") for task in BOARD_GOALS if row.estimate(task, "exploration")]
    rows = (
        Row(
            (str(seed),),
            tuple(
                labels.estimate_cell(name, run[task].estimates.get(name)) for task, name in wanted
            ),
        )
        for seed, run in zip(row.training_seeds, runs, strict=True)
    )
    titles = (f"{task_title(task)}: {METRICS[name].label.lower()}" for task, name in wanted)
    notes = ("Brackets: 95 % interval over episodes.",)
    return Table(
        "By training seed", ("Seed",), tables.make_columns(*titles), tuple(rows), notes=notes
    )


def _fresh(row: BoardRow) -> Table:
    """Lay out the official and the fresh value of what ranks each table."""
    rows = []
    for key, metrics in row.fresh.items():
        for name in dict.fromkeys((RANKED_BY[key], "exploration")):
            if name in metrics and key not in MEAN_OF:
                both = (row.figures[key][name], metrics[name])
                head = (_title(key), METRICS[name].label)
                rows.append(Row(head, tuple(labels.estimate_cell(name, one) for one in both)))
    return Table(
        title="Fresh episodes",
        corner=("Task", "Metric"),
        columns=tables.make_columns("Official", "Fresh"),
        rows=tuple(rows),
        notes=(
            f"Brackets: 95 % interval. Fresh: {FRESH_EPISODES} episodes per task and training. One "
            "joint test over tasks, trainings, suites and exploration: an equally good policy "
            f"drops at least as much with probability {row.drop_p:.2g}.",
        ),
    )


def _gaps(row: BoardRow) -> Table:
    rows = (
        Row(
            (task_title(task), METRICS[RANKED_BY[task]].label),
            gap_cells(task, RANKED_BY[task], gap),
        )
        for task, gap in row.novel_shapes.items()
    )
    columns = tables.make_columns("Held-out", "Train", "Gap", "Verdict", words=("Verdict",))
    return Table("Novel shapes", ("Task", "Metric"), columns, tuple(rows))


def _faults(runs: Mapping[str, Sequence[Run]]) -> Mapping[str, Sequence[str]]:
    """Return each fault's text with its episodes, each named with its run."""
    return group_faults(
        (f"{run.name.partition('/')[2]} {key}", text)
        for of_suite in runs.values()
        for run in of_suite
        for key, text in run.faults.items()
    )


def submission_figures(played: PlayedRow) -> tuple[Figure, ...]:
    """Return where a row's episodes succeed, how long they last, and how they touch."""
    runs = played.official[MAIN_SUITE]
    several = "; a line per training seed" if len(runs) > 1 else ""
    episodes = {task: [*chain(*played.episodes(task))] for task in BOARD_GOALS}
    mapped = [MappedTask(task, task_title(task), played.episodes(task)) for task in BOARD_TASKS]
    panels = {task: {"": rows} for task, rows in episodes.items()}
    figures = (
        start_figure(mapped),
        steps_figure(panels),
        touch_figure(BOARD_TASKS, runs, more=several),
        peak_figure(panels),
    )
    return tuple(figure for figure in figures if figure.plots)
