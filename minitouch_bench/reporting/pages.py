"""Pages that are complete in themselves: one frame, one style, one Jinja environment.

A page loads no script, style or font; a policy of hashes forbids all but its own.
"""

import base64
import hashlib
from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from minitouch_bench.errors import printable
from minitouch_bench.reporting.charts import COLORS
from minitouch_bench.reporting.svg import draw_gauge, draw_plot

TEMPLATES = Path(__file__).parent / "templates"
STYLE = "page.css"

PICTURES = Path(__file__).parent / "pictures"


def render_page(
    template: Path, styles: tuple[str, ...] = (), scripts: tuple[str, ...] = (), **context: object
) -> str:
    """Render a template; ``styles`` and ``scripts``, beside it or the kit's, become part of it."""
    environment = _environment(template.parent)
    frame = _frame(template.parent, (STYLE, *styles), scripts)
    return environment.get_template(template.name).render(**frame, **context)


@cache
def _environment(templates: Path) -> Environment:
    """Return the templates: everything escaped, and a missing variable is an error."""
    environment = Environment(
        loader=FileSystemLoader([templates, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"printable": printable, "draw": draw_plot, "gauge": draw_gauge}
    return environment


@cache
def _frame(templates: Path, styles: tuple[str, ...], scripts: tuple[str, ...]) -> dict[str, object]:
    """Return the texts of a page's style and scripts, and the policy that allows these alone."""
    environment = _environment(templates)
    style = "".join(environment.get_template(name).render(colors=COLORS) for name in styles)
    texts = [environment.get_template(name).render() for name in scripts]
    policy = (
        f"default-src 'none'; style-src {_hash(style)}; "
        + (f"script-src {' '.join(map(_hash, texts))}; " if texts else "")
        + "img-src 'self' file: data:; media-src 'self' file:; base-uri 'none'; form-action 'none'"
    )
    return {
        "style": Markup(style),
        "scripts": tuple(map(Markup, texts)),
        "policy": Markup(policy),
    }


def _hash(text: str) -> str:
    digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
    return f"'sha256-{digest}'"


def image_uri(task: str, directory: Path = PICTURES) -> str:
    """Return a task's image as a data URI, "" if its file is missing."""
    file = directory / f"{Path(task).name}.png"
    if not file.is_file():
        return ""
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode("ascii")
