"""Tables as data; Markdown, LaTeX, the terminal and pages draw the same ones."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from minitouch_bench.episode import Estimate
from minitouch_bench.metrics.definitions import METRICS

ABSENT = "—"
"""Written where a value does not exist; 0 would be a claim."""


@dataclass(frozen=True)
class Gauge:
    """An estimate on a scale from 0 to 1, with a mark for comparison, all in percent."""

    value: float
    low: float
    high: float
    mark: float | None


@dataclass(frozen=True)
class Cell:
    """A value as text.

    ``small`` is printed below or behind the value: its interval, or a mark. ``title`` says how
    both were made. A sort goes by ``sort_key``.
    """

    text: str = ABSENT
    small: str = ""
    title: str = ""
    sort_key: float | None = None
    gauge: Gauge | None = None

    def __str__(self) -> str:
        return f"{self.text} {self.small}".rstrip()


@dataclass(frozen=True)
class Column:
    """A column: ``group`` names the block it belongs to, "" for none.

    ``is_text`` marks a column of words, which may be broken into lines, ``is_code`` one of
    commands to copy.
    """

    label: str
    group: str = ""
    unit: str = ""
    is_paper: bool = False
    is_text: bool = False
    is_code: bool = False


@dataclass(frozen=True)
class Row:
    """A row; ``heads`` are the cells that name it, ``unit`` what its values count."""

    heads: tuple[str, ...]
    cells: tuple[Cell, ...]
    unit: str = ""


def make_columns(*labels: str, words: Sequence[str] = ()) -> tuple[Column, ...]:
    """Return columns of these labels; those that are in ``words`` are of text."""
    return tuple(Column(label, is_text=label in words) for label in labels)


def make_row(heads: str | tuple[str, ...], *cells: Cell | str | None) -> Row:
    """Return a row of cells and of texts; None is a value that does not exist."""
    heads = (heads,) if isinstance(heads, str) else heads
    return Row(
        heads, tuple(cell if isinstance(cell, Cell) else Cell(cell or ABSENT) for cell in cells)
    )


@dataclass(frozen=True)
class Table:
    """A table ready to draw: ``corner`` names the row heads, ``notes`` are printed below."""

    title: str
    corner: tuple[str, ...]
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()

    @property
    def groups(self) -> tuple[tuple[str, int], ...]:
        """The blocks of columns in order, each with its number of columns."""
        return column_groups(self.columns)

    def block(self, group: str) -> "Table":
        """Return one block of columns, without the rows that have no value in it."""
        block = self._select(
            [index for index, column in enumerate(self.columns) if column.group == group]
        )
        return replace(block.filled_rows(), title=group)

    def filled_rows(self) -> "Table":
        """Return the table without the rows that have no value."""
        rows = (row for row in self.rows if any(cell.text != ABSENT for cell in row.cells))
        return replace(self, rows=tuple(rows))

    def filled_columns(self) -> "Table":
        """Return the table without the columns that have no value."""
        return self._select(
            [
                index
                for index in range(len(self.columns))
                if any(row.cells[index].text != ABSENT for row in self.rows)
            ]
        )

    def _select(self, kept: Sequence[int]) -> "Table":
        rows = (replace(row, cells=tuple(row.cells[index] for index in kept)) for row in self.rows)
        columns = tuple(self.columns[index] for index in kept)
        return replace(self, columns=columns, rows=tuple(rows))


def column_groups(columns: tuple[Column, ...]) -> tuple[tuple[str, int], ...]:
    """Return the blocks of columns in order, each with its number of columns."""
    return tuple(Counter(column.group for column in columns).items())


def format_value(metric: str, value: float) -> str:
    """Write a value of a metric with the digits it deserves."""
    return format(value, METRICS[metric].number_format)


def metric_head(metric: str, task: str | None = None) -> str:
    """Name a metric with the arrow of its better direction, in one task or in all of them."""
    known = METRICS[metric]
    if task is None and known.task_directions:
        arrows = (f"{arrow} in {name}" for name, arrow in known.task_directions.items())
        return f"{known.label} ({', '.join(arrows)})"
    return f"{known.label} {known.direction_in(task or '')}".rstrip()


def estimate_cell(metric: str, estimate: Estimate | None, mark: float | None = None) -> Cell:
    """Write an estimate with its interval, a share with a gauge and ``mark``; a dash for none."""
    if estimate is None:
        return Cell()
    low, high = format_value(metric, estimate.low), format_value(metric, estimate.high)
    return Cell(
        text=format_value(metric, estimate.value),
        small=f"[{low}, {high}]",
        title=_method(estimate),
        sort_key=estimate.value,
        gauge=_gauge(estimate, mark) if METRICS[metric].is_share else None,
    )


def difference_cell(metric: str, difference: Estimate) -> Cell:
    """Write a difference with its sign and interval; what rounds to 0 has a plus."""
    value, low, high = (
        format(number, f"+z{METRICS[metric].number_format}")
        for number in (difference.value, difference.low, difference.high)
    )
    return Cell(value, f"[{low}, {high}]", _method(difference), difference.value)


def _method(estimate: Estimate) -> str:
    counted = "training seeds" if "training seeds" in estimate.method else "episodes"
    return f"{estimate.count} {counted}, 95 % interval: {estimate.method}"


def _gauge(estimate: Estimate, mark: float | None) -> Gauge:
    return Gauge(
        value=_percent(estimate.value),
        low=_percent(estimate.low),
        high=_percent(estimate.high),
        mark=None if mark is None else _percent(mark),
    )


def _percent(share: float) -> float:
    return round(100 * min(max(share, 0.0), 1.0), 2)
