import subprocess
import sys
import time

import numpy as np
import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.shapegen import generate as generating
from minitouch_bench.shapegen.families import FAMILIES
from minitouch_bench.shapegen.generate import PARTIAL, generate
from minitouch_bench.shapegen.manifest import canonical_shape_set, load_shape_set
from minitouch_bench.shapegen.soundness import Reason, UnsoundError
from tests.shapegen.conftest import entry_of


@pytest.fixture
def _instant(monkeypatch):
    """Answer as a generator would, from the canonical set."""
    shapes = canonical_shape_set().shapes

    def answer(_, tasks, *__, **___):
        return ((i, (entry_of(n), shapes[n].record())) for i, (_, n) in enumerate(tasks))

    monkeypatch.setattr(generating, "run_in_workers", answer)


def test_a_shape_that_is_too_long_for_its_record_is_another_draw(monkeypatch):
    monkeypatch.setattr(generating.soundness, "grip_scale", lambda *_: 3.0)
    rng = np.random.default_rng(0)
    with pytest.raises(UnsoundError, match="65 mm") as refused:
        generating.sized(FAMILIES["lathed"](rng), rng)
    assert refused.value.reason is Reason.SIZE


@pytest.mark.usefixtures("_instant")
def test_what_was_made_before_is_kept(tmp_path):
    folder = tmp_path / "set"

    def stop(done, _):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(folder, 8, 0, 1, stop)
    with pytest.raises(RunDirectoryError, match="other settings"):
        generate(folder, 9, 0, 1)
    partial = folder / PARTIAL
    partial.write_bytes(partial.read_bytes()[:-9])  # killed while it wrote the third
    seen = []
    again = generate(folder, 8, 0, 1, lambda done, _: seen.append(done))
    assert seen[0] == 2
    assert generate(tmp_path / "fresh", 8, 0, 1) == again
    assert not partial.exists()
    assert len(load_shape_set(folder).shapes) == 8
    with pytest.raises(RunDirectoryError, match="finished set"):
        generate(folder, 8, 0, 1)


@pytest.mark.usefixtures("_instant")
def test_damaged_work_and_other_files_are_refused(tmp_path):
    for number, content in enumerate((b"", b'HEAD{"index": 1}\n', b"HEAD\x80\n")):
        folder = tmp_path / str(number)
        with pytest.raises(OSError, match="full"):
            generate(folder, 8, 0, 1, _full)
        partial = folder / PARTIAL
        partial.write_bytes(content.replace(b"HEAD", partial.read_bytes()))
        with pytest.raises(RunDirectoryError, match="delete it or choose"):
            generate(folder, 8, 0, 1)
    (tmp_path / "run" / "videos").mkdir(parents=True)
    with pytest.raises(RunDirectoryError, match="not empty"):
        generate(tmp_path / "run", 8, 0, 1)


def _full(*_):
    raise OSError("full")


@pytest.mark.slow
def test_workers_and_kill_nine_change_nothing(tmp_path):
    one = generate(tmp_path / "1", 24, 0, 1)
    command = [sys.executable, "-m", "minitouch_bench", "shapes", "generate", "--count", "24",
               "--workers", "2", "--output", str(tmp_path / "2")]  # fmt: skip
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    partial = tmp_path / "2" / PARTIAL
    while not partial.exists() or partial.read_bytes().count(b"\n") < 5:
        time.sleep(0.2)
    process.kill()
    process.wait()
    assert generate(tmp_path / "2", 24, 0, 2) == one
    packs = [(tmp_path / name / "shapes.bin").read_bytes() for name in ("1", "2")]
    assert packs[0] == packs[1]
    found = load_shape_set(tmp_path / "2").shapes
    there = canonical_shape_set().shapes[:24]
    assert [(s.digest, s.split) for s in found] == [(s.digest, s.split) for s in there]
