from pathlib import Path

import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.shapegen import generate as generating
from minitouch_bench.shapegen.generate import generate
from minitouch_bench.shapegen.manifest import canonical_shape_set, load_shape_set
from tests.shapegen.conftest import entry_of


def stand_in(task: tuple[int, int]) -> tuple[dict[str, object], bytes]:
    """Answer as a generator would, from the canonical set."""
    return entry_of(task[1]), canonical_shape_set().shapes[task[1]].record()


@pytest.fixture
def _instant(monkeypatch: pytest.MonkeyPatch) -> None:
    def answer(_: object, tasks: list[tuple[int, int]], *__: int, **___: object) -> object:
        return ((i, stand_in(task)) for i, task in enumerate(tasks))

    monkeypatch.setattr(generating, "run_in_workers", answer)


@pytest.mark.usefixtures("_instant")
def test_folders_of_others_are_left_alone(tmp_path: Path) -> None:
    generate(tmp_path, 2, 0, 1)
    with pytest.raises(RunDirectoryError, match="finished set"):
        generate(tmp_path, 2, 0, 1)


@pytest.mark.slow
def test_workers_change_nothing(tmp_path: Path) -> None:
    one, two = (generate(tmp_path / str(n), 24, 0, n).digest for n in (1, 2))
    assert one == two
    packs = [(tmp_path / name / "shapes.bin").read_bytes() for name in ("1", "2")]
    assert packs[0] == packs[1]
    found = load_shape_set(tmp_path / "2").shapes
    there = canonical_shape_set().shapes[:24]
    assert [(s.digest, s.split) for s in found] == [(s.digest, s.split) for s in there]
