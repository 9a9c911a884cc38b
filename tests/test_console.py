import io
import signal

import IPython.display
import numpy as np
import pytest
from rich.console import Console

from minitouch_bench import console
from minitouch_bench.agents.training import COLUMNS, ProgressRow
from minitouch_bench.console import episode_progress
from minitouch_bench.episode import EpisodeSpec, Role
from tests.reporting.synthetic import make_record

SPEC = EpisodeSpec(Role.FINAL, "pushing", 0, 1, 0, "cube")
RECORD = make_record(np.random.default_rng(1), SPEC, 1.0)


def test_without_a_terminal_there_is_one_line_per_minute(monkeypatch):
    now = [0.0]
    screen = Console(file=io.StringIO(), width=200)
    monkeypatch.setattr(console, "notes", lambda: screen)
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with episode_progress() as callbacks:
        callbacks.phase("episodes", 20)
        for second in range(0, 200, 10):
            now[0] = float(second)
            callbacks.episode(RECORD)
        lines = screen.file.getvalue().splitlines()
    assert [line.split("  ")[0].strip() for line in lines] == [
        "episodes: 7 of 20", "episodes: 13 of 20", "episodes: 19 of 20",
    ]  # fmt: skip


@pytest.fixture
def _new_consoles():
    console.notes.cache_clear()
    yield
    console.notes.cache_clear()


@pytest.mark.usefixtures("_new_consoles")
def test_no_word_between_colons_becomes_a_picture(capsys):
    console.note("agents:robot: it cannot be imported")
    console.data_console().print("runs:car:", markup=False)
    shown = capsys.readouterr()
    assert (shown.err, shown.out) == ("agents:robot: it cannot be imported\n", "runs:car:\n")


@pytest.mark.usefixtures("_new_consoles")
def test_colors_in_a_pipe_make_no_screen_of_it(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "80")
    assert not console.is_watched()
    with episode_progress() as callbacks:
        callbacks.phase("episodes", 3)
        callbacks.episode(RECORD)
    console.data_console().print("[bold]" + "word " * 50)
    shown = capsys.readouterr()
    assert shown.out == f"\x1b[1m{'word ' * 50}\x1b[0m\n"
    assert "\x1b" not in shown.err


def test_in_a_notebook_one_bar_is_drawn_again_in_place(monkeypatch):
    """Of IPython only the function that shows a cell's output is replaced."""
    outputs = []

    class Cell:
        def __init__(self, shown, **_):
            outputs.append([shown])
            self.update = lambda shown, raw: outputs[-1].append(shown)

    monkeypatch.setattr(IPython.display, "display", Cell)
    screen = Console(file=io.StringIO(), force_jupyter=True)
    monkeypatch.setattr(console, "notes", lambda: screen)
    with episode_progress() as callbacks:
        callbacks.phase("episodes", 3)
        for _ in range(3):
            callbacks.episode(RECORD)
    assert [len(cell) for cell in outputs] == [3]
    assert screen.file.getvalue() == ""


def test_a_training_shows_its_rows_and_is_stopped_by_a_ctrl_c(monkeypatch, capsys):
    monkeypatch.setattr(console, "LINE_INTERVAL_S", 0.0)
    with console.training_progress() as callbacks:
        callbacks.phase("training", 2000)
        row = dict.fromkeys(COLUMNS) | {"step": 500, "phase": "exploration", "touch_share": 0.25}
        callbacks.row(ProgressRow(**row))
        assert not callbacks.should_stop()
        signal.raise_signal(signal.SIGINT)
        assert callbacks.should_stop()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert "exploration: 500 of 2,000 control steps  touch 0.25" in capsys.readouterr().err
