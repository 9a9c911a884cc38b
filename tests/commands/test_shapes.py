"""``shapes``: what its commands say and how they end."""

from typer.testing import CliRunner

from minitouch_bench.commands.shapes import app
from minitouch_bench.shapegen import exchange
from minitouch_bench.shapegen.soundness import Reason
from tests.commands.command import run


def imported(monkeypatch, tmp_path, refused, *options, accepted=1):
    """Run ``import`` where the objects have been refused for these reasons."""

    def import_objects(source, folder, config, workers, progress):
        return exchange.ImportResult("d" * 64, accepted, refused, {})

    monkeypatch.setattr(exchange, "import_objects", import_objects)
    command = ["import", str(tmp_path), "--output", str(tmp_path / "set"), *options]
    return CliRunner().invoke(app, command)


def test_a_refusal_has_no_progress_bar(tmp_path):
    run("shapes", "check", "gone", directory=tmp_path).refused(2, "gone")


TOO_LONG = {"mug.stl": f"{Reason.SIZE} (102.1 mm)"}


def test_an_import_with_a_refusal_exits_1_and_keeps_the_set(monkeypatch, tmp_path):
    done = imported(monkeypatch, tmp_path, TOO_LONG)
    assert done.exit_code == 1
    assert "1 accepted, 1 refused" in done.stdout
    assert "set in " in done.stdout
    assert imported(monkeypatch, tmp_path, {}).exit_code == 0
    none = imported(monkeypatch, tmp_path, TOO_LONG, accepted=0)
    assert none.exit_code == 1
    assert "set in " not in none.stdout
