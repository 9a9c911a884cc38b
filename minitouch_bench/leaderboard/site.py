"""The static site: an index and a page a submission, each complete in itself.

No page loads a script, a style or a font; a policy with hashes forbids all but its own.
"""

import base64
import hashlib
import shutil
from functools import cache, partial
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.evaluation.suites import SUITES
from minitouch_bench.files import os_errors_as, read_file, write_file
from minitouch_bench.leaderboard.board import Board, Row
from minitouch_bench.leaderboard.board_markdown import notes
from minitouch_bench.leaderboard.drawings import amount, efficiency_plot
from minitouch_bench.leaderboard.inventory import MAX_VIDEO
from minitouch_bench.leaderboard.page import page_context
from minitouch_bench.leaderboard.proof import MEANINGS, ProofLevel
from minitouch_bench.leaderboard.scores import MEAN_SUCCESS, OVERALL
from minitouch_bench.leaderboard.submission import MAIN_SUITE, MODALITIES
from minitouch_bench.leaderboard.views import Heading, View, views
from minitouch_bench.processes import run_all
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.cards import PICTURES
from minitouch_bench.reporting.html import TEMPLATES as REPORT_TEMPLATES
from minitouch_bench.reporting.paper import PAPER_TASKS

TEMPLATES = Path(__file__).parent / "templates"
PAGES = "submission"
"""Directory of the submissions' pages in the site."""


def write_site(board: Board, output: Path) -> None:
    """Write the index, the pages, and the pictures and videos they show.

    Pages of submissions that are gone are removed.

    Raises:
        RunDirectoryError: a file cannot be written.
    """
    write_file(output / "index.html", index_html(board))
    pages = output / PAGES
    write = partial(_write_page, pages, board.protocol, len(board.ranked))
    run_all(write, board.rows, name=lambda row: f"the page of {row.entry.name}")
    _remove_others(pages, {row.entry.name for row in board.rows})
    for task in PAPER_TASKS:
        name = f"{task}.png"
        write_file(output / "pictures" / name, (PICTURES / name).read_bytes())


def index_html(board: Board) -> str:
    """Write the index."""
    tables = views(board)
    points = [
        (row.entry.name, row.entry.about.training_steps, found.value, found.low, found.high)
        for row in board.ranked
        if (found := row.estimate(OVERALL, MEAN_SUCCESS)) is not None
    ]
    suite = SUITES[MAIN_SUITE]
    return _render(
        "board.html.j2",
        "board.js",
        {
            "board": board,
            "views": tables,
            "view_edges": {view.key: _edges(view) for view in tables},
            "levels": list(ProofLevel),
            "meanings": MEANINGS,
            "modalities": MODALITIES,
            "notes": notes(),
            "episodes": len(suite.tasks) * suite.episodes_per_task,
            "efficiency": Markup(efficiency_plot(points)),
        },
    )


def _write_page(pages: Path, protocol: str, ranked: int, row: Row) -> None:
    """Write the page of one submission of ``ranked``, and its videos."""
    context = page_context(row, ranked)
    context |= {"protocol": protocol, "videos": _copy_videos(row, pages)}
    text = _render("submission.html.j2", "submission.js", context)
    write_file(pages / f"{row.entry.name}.html", text)


def _render(template: str, script: str, context: dict[str, Any]) -> str:
    own = _assets(script)
    return _environment().get_template(template).render(**own, **context)


@cache
def _environment() -> Environment:
    """Return the templates: everything escaped, and a missing variable is an error."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "printable": printable,
        "amount": amount,
        "percent": lambda share: f"{100 * share:.1f}",
        "groups": _groups,
    }
    return environment


@cache
def _assets(script: str) -> dict[str, Markup]:
    """Return the texts of a page's style and scripts, and the policy that allows these alone."""
    report = (REPORT_TEMPLATES / "report.css").read_text(encoding="utf-8")
    style = f"{report}\n{(TEMPLATES / 'site.css').read_text(encoding='utf-8')}"
    texts = [(TEMPLATES / name).read_text(encoding="utf-8") for name in ("theme.js", script)]
    scripts = " ".join(map(_hash, texts))
    policy = (
        f"default-src 'none'; script-src {scripts}; style-src {_hash(style)}; "
        "img-src 'self' file: data:; media-src 'self' file:; base-uri 'none'; form-action 'none'"
    )
    return {
        "style": Markup(style),
        "theme": Markup(texts[0]),
        "script": Markup(texts[1]),
        "policy": Markup(policy),
    }


def _hash(text: str) -> str:
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"


def _groups(headings: tuple[Heading, ...]) -> list[tuple[str, int]]:
    """Return the blocks of columns in order, each with its number of columns."""
    spans: dict[str, int] = {}
    for heading in headings:
        spans[heading.group] = spans.get(heading.group, 0) + 1
    return list(spans.items())


def _edges(view: View) -> frozenset[int]:
    """Return the columns that begin a block."""
    groups = [heading.group for heading in view.headings]
    return frozenset(
        place
        for place, group in enumerate(groups)
        if group and (place == 0 or groups[place - 1] != group)
    )


def _copy_videos(row: Row, pages: Path) -> tuple[tuple[str, str], ...]:
    """Copy a submission's videos beside its page; return their addresses and captions."""
    target = pages / row.entry.name
    shutil.rmtree(target, ignore_errors=True)
    found = []
    for path in row.entry.videos:
        # The parts were checked: seed, suite, "videos", and a plain name.
        name = path.replace("/videos/", "-").replace("/", "-")
        with os_errors_as(RunDirectoryError, row.entry.directory / path, "copied"):
            write_file(target / name, read_file(row.entry.directory / path, MAX_VIDEO))
        found.append((f"{row.entry.name}/{name}", Path(name).stem.replace("-", " ")))
    return tuple(found)


def _remove_others(pages: Path, names: set[str]) -> None:
    """Remove the pages and videos of submissions that are no longer there."""
    if not pages.is_dir():
        return
    for path in pages.iterdir():
        if path.is_dir() and path.name not in names:
            shutil.rmtree(path, ignore_errors=True)
        elif path.suffix == ".html" and path.stem not in names:
            path.unlink()
