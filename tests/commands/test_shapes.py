"""``shapes``: what its commands say and how they end."""

import pytest

from minitouch_bench.shapegen import exchange
from tests.commands.command import run


def test_a_refusal_has_no_progress_bar(tmp_path):
    run("shapes", "check", "gone", directory=tmp_path).refused(2, "gone")


# With one that is refused beside one that is accepted: test_own_objects.py.
@pytest.mark.parametrize(("accepted", "refused"), [(1, {}), (0, {"mug.stl": "too long"})])
def test_an_import_of_all_exits_0_and_one_of_none_1(monkeypatch, tmp_path, accepted, refused):
    result = exchange.ImportResult("d" * 64, accepted, refused, {})
    monkeypatch.setattr(exchange, "import_objects", lambda *_: result)
    done = run("shapes", "import", tmp_path, "--output", "set", directory=tmp_path)
    assert done.code == len(refused)
    assert ("set in " in done.out) == bool(accepted)
