import errno
import fcntl
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from minitouch_bench.errors import InfrastructureError, RunDirectoryError
from minitouch_bench.shapegen import generate as generating
from minitouch_bench.shapegen.generate import generate, write_partial
from minitouch_bench.shapegen.manifest import canonical_shape_set, load_shape_set
from minitouch_bench.shapegen.workers import map_in_workers


def stand_in(task: tuple[int, int]) -> tuple[dict[str, object], bytes]:
    """Answer as a generator would, from the canonical set."""
    shape = canonical_shape_set().shapes[task[1]]
    place = ("split", "offset", "length")
    return {k: v for k, v in shape.entry.items() if k not in place}, shape.record()


@pytest.fixture
def _instant(monkeypatch: pytest.MonkeyPatch) -> None:
    def answer(target: str, tasks: list[tuple[int, int]], workers: int) -> object:
        return ((i, stand_in(task)) for i, task in enumerate(tasks))

    monkeypatch.setattr(generating, "map_in_workers", answer)


def die_once(path: str) -> str:
    if not Path(path).exists():
        Path(path).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "alive"


def die(_: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail(number: int) -> int:
    raise ValueError(f"no {number}")


def test_a_dead_workers_task_is_tried_once_more(tmp_path: Path) -> None:
    tasks = [str(tmp_path / "a"), str(tmp_path / "b")]
    found = dict(map_in_workers(f"{__name__}:die_once", tasks, 2))
    assert found == {0: "alive", 1: "alive"}


def test_a_worker_that_dies_twice_fails_loudly() -> None:
    with pytest.raises(InfrastructureError, match="died twice on task 0"):
        list(map_in_workers(f"{__name__}:die", [1], 1))


def test_an_error_in_a_worker_is_named() -> None:
    with pytest.raises(InfrastructureError, match="ValueError: no 3"):
        list(map_in_workers(f"{__name__}:fail", [3], 1))


@pytest.mark.usefixtures("_instant")
def test_what_was_made_before_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        whole = generating.map_in_workers

        def until_three(*arguments: object) -> object:
            for done, answer in enumerate(whole(*arguments)):  # type: ignore[arg-type]
                if done == 3:
                    raise KeyboardInterrupt
                yield answer

        patch.setattr(generating, "map_in_workers", until_three)
        with pytest.raises(KeyboardInterrupt):
            generate(tmp_path / "set", 8, 0, 1)
    (tmp_path / "set/.partial/1.shape").write_bytes(b"torn")
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
    with pytest.raises(RunDirectoryError, match="another generator is at work"):
        generate(tmp_path, 2, 0, 1)
    os.close(handle)


def test_another_plan_in_the_folder(tmp_path: Path) -> None:
    generating.opened_partial(tmp_path, {"seed": 0})
    with pytest.raises(RunDirectoryError, match="other settings"):
        generating.opened_partial(tmp_path, {"seed": 1})


def test_a_full_disk_keeps_what_was_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_partial(tmp_path, 0, {"sha256": ""}, b"first")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(generating, "replace_file", full)
    with pytest.raises(InfrastructureError, match=r"No space left on device.*are kept"):
        write_partial(tmp_path, 1, {"sha256": ""}, b"second")
    assert (tmp_path / "0.shape").exists()


@pytest.mark.slow
def test_workers_and_kill_nine_change_nothing(tmp_path: Path) -> None:
    one = generate(tmp_path / "one", 24, 0, 1).digest
    command = [sys.executable, "-m", "minitouch_bench.cli.shapes", "generate", "--count", "24",
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
