import errno
import fcntl
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from minitouch_bench.errors import InfrastructureError, RunDirectoryError
from minitouch_bench.shapegen import generate as generating
from minitouch_bench.shapegen.generate import generate, open_parts
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
def test_what_was_made_before_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        whole = generating.run_in_workers

        def until_three(*arguments: object, **names: object) -> object:
            for done, answer in enumerate(whole(*arguments, **names)):  # type: ignore[arg-type]
                if done == 3:
                    raise KeyboardInterrupt
                yield answer

        patch.setattr(generating, "run_in_workers", until_three)
        with pytest.raises(KeyboardInterrupt):
            generate(tmp_path / "set", 8, 0, 1)
    (tmp_path / "set/.partial/1.shape").unlink()
    seen: list[int] = []
    again = generate(tmp_path / "set", 8, 0, 1, lambda done, total: seen.append(done))
    assert seen[0] == 2
    assert generate(tmp_path / "fresh", 8, 0, 1).digest == again.digest
    assert not (tmp_path / "set/.partial").exists()
    assert len(load_shape_set(tmp_path / "set").shapes) == 8


@pytest.mark.usefixtures("_instant")
def test_folders_of_others_are_left_alone(tmp_path: Path) -> None:
    generate(tmp_path, 2, 0, 1)
    with pytest.raises(RunDirectoryError, match="finished set"):
        generate(tmp_path, 2, 0, 1)


@pytest.mark.usefixtures("_instant")
def test_two_generators_in_one_folder(tmp_path: Path) -> None:
    handle = os.open(tmp_path / ".lock", os.O_CREAT | os.O_RDWR)
    fcntl.flock(handle, fcntl.LOCK_EX)
    with pytest.raises(RunDirectoryError, match="in use by another process"):
        generate(tmp_path, 2, 0, 1)
    os.close(handle)


def test_another_plan_in_the_folder(tmp_path: Path) -> None:
    open_parts(tmp_path, {"seed": 0})
    with pytest.raises(RunDirectoryError, match="other settings"):
        open_parts(tmp_path, {"seed": 1})


def test_a_full_disk_keeps_what_was_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = open_parts(tmp_path, {"seed": 0})
    generating.keep_shape(parts, 0, {"sha256": ""}, b"first")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("minitouch_bench.shapegen.generate.replace_file", full)
    with pytest.raises(InfrastructureError, match=r"No space left on device.*are kept"):
        generating.keep_shape(parts, 1, {"sha256": ""}, b"second")
    assert (tmp_path / ".partial" / "0.shape").exists()


@pytest.mark.slow
def test_workers_and_kill_nine_change_nothing(tmp_path: Path) -> None:
    one = generate(tmp_path / "one", 24, 0, 1).digest
    command = [sys.executable, "-m", "minitouch_bench.commands.shapes", "generate", "--count", "24",
               "--workers", "2", "--output", str(tmp_path / "two")]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    partial = tmp_path / "two/.partial"
    while len(list(partial.glob("*.shape"))) < 5:
        time.sleep(0.2)
    process.kill()
    process.wait()
    assert generate(tmp_path / "two", 24, 0, 2).digest == one
    packs = [(tmp_path / name / "shapes.bin").read_bytes() for name in ("one", "two")]
    assert packs[0] == packs[1]
    found = load_shape_set(tmp_path / "two").shapes
    there = canonical_shape_set().shapes[:24]
    assert [(s.digest, s.split) for s in found] == [(s.digest, s.split) for s in there]


def test_libraries_of_other_versions_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert generating.other_libraries() == ()
    monkeypatch.setattr(generating, "installed_versions", lambda _: {"coacd": "1.0.99"})
    assert "coacd 1.0.99" in generating.other_libraries()[0]
