"""The episodes of an unfinished run: kept whole or played again, whatever the files hold."""

import io
import os
import resource
import shutil
import tracemalloc

import numpy as np
import pytest

from minitouch_bench.errors import InfrastructureError, RunDirectoryError
from minitouch_bench.evaluation.run import header_of, package_versions
from minitouch_bench.files import MIB, UNFINISHED
from minitouch_bench.metrics.summary import measure
from minitouch_bench.runs.unfinished import UnfinishedRun
from minitouch_bench.units import Units
from tests.evaluation.runs import request

REQUEST = request()
SPECS = REQUEST.plan.specs()
HEADER, PACKAGES = header_of(REQUEST), package_versions()
REST = [spec.key for spec in SPECS[1:]]


@pytest.fixture
def folder(finished, tmp_path):
    """What the finished run kept until it was finished, to be damaged."""
    return shutil.copytree(finished[1] / UNFINISHED, tmp_path / "run" / UNFINISHED)


def kept(folder):
    return UnfinishedRun(folder.parent).records(SPECS)


def keys(folder):
    return [record.spec.key for record in kept(folder)]


def test_what_is_kept_is_read(finished, folder):
    UnfinishedRun(folder.parent).check(HEADER, PACKAGES)
    records = kept(folder)
    assert tuple(map(measure, records)) == finished[0].episodes
    assert [record.spec for record in records] == list(SPECS)


def test_a_unit_that_is_cut_or_has_another_bit_is_missing(folder):
    file = folder / "pushing-0.unit"
    content = file.read_bytes()
    for end in [*range(70), *range(70, len(content), 97), len(content) - 1]:
        file.write_bytes(content[:end])
        assert Units(folder, ".unit").read("pushing-0") is None
        damaged = bytearray(content)
        damaged[end] ^= 0x04
        file.write_bytes(damaged)
        assert Units(folder, ".unit").read("pushing-0") is None
    assert keys(folder) == REST


@pytest.mark.parametrize("damage", ["cut", "gone", "other"])
def test_episodes_without_their_header_are_refused(folder, damage):
    file = folder / "header.unit"
    if damage == "gone":
        file.unlink()
    elif damage == "cut":
        os.truncate(file, 100)
    else:
        Units(folder, ".unit").keep("header", b'{"header": []}')
    with pytest.raises(RunDirectoryError, match=r"header\.unit"):
        UnfinishedRun(folder.parent).check(HEADER, PACKAGES)


def test_a_run_that_was_killed_before_its_header_begins(tmp_path):
    (tmp_path / UNFINISHED).mkdir()
    (tmp_path / UNFINISHED / ".0123456789abcdef.partial").write_text("{")
    for _ in range(2):
        UnfinishedRun(tmp_path).check(HEADER, PACKAGES)
    assert (tmp_path / UNFINISHED / "header.unit").exists()


def test_an_episode_under_another_name_or_of_another_run_is_played_again(folder):
    shutil.copy(folder / "pushing-1.unit", folder / "pushing-0.unit")
    assert keys(folder) == REST
    others = request(seed=1).plan.specs()
    assert UnfinishedRun(folder.parent).records(others) == ()


def with_arrays(folder, change):
    """Change the arrays of the first episode; its digest is right."""
    units = Units(folder, ".unit")
    head, _, packed = units.read("pushing-0").partition(b"\n")
    arrays = dict(np.load(io.BytesIO(packed)))
    change(arrays)
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    units.keep("pushing-0", head + b"\n" + content.getvalue())


def test_the_arrays_themselves_are_no_difference(folder):
    with_arrays(folder, lambda arrays: None)
    assert len(kept(folder)) == len(SPECS)


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("touch", lambda array: np.zeros(30_000_000, np.float32)),
        ("touch", lambda array: array[:-1]),
        ("touch", lambda array: np.full_like(array, np.inf)),
        ("actions", lambda array: array[:, :3]),
        ("actions", lambda array: array + 1),
        ("actions", lambda array: array.astype(">f4")),
        ("actions", lambda array: array[0, 0]),
        ("rewards", lambda array: array * np.float32(np.nan)),
        ("ticks", lambda array: -array),
        ("object_state", lambda array: array[0, 0]),
        ("object_state", lambda array: np.where(array < array.mean(), -1e308, 1e308)),
        ("clipped", None),
        ("extra", lambda array: np.zeros(3)),
    ],
)
def test_arrays_of_no_episode_are_played_again_and_take_no_memory(folder, name, other):
    def change(arrays):
        array = arrays.pop(name, None)
        if other is not None:
            arrays[name] = other(array)

    with_arrays(folder, change)
    tracemalloc.start()
    assert keys(folder) == REST
    assert tracemalloc.get_traced_memory()[1] < 20 * MIB
    tracemalloc.stop()


def test_200_steps_are_the_most(folder):
    with_arrays(
        folder,
        lambda arrays: arrays.update(
            {name: np.resize(a, (201 + (name in {"touch", "object_state"}), *a.shape[1:]))
             for name, a in arrays.items()}
        ),
    )  # fmt: skip
    assert keys(folder) == REST


@pytest.mark.parametrize("content", [b"", b"[" * 100_000, b"[]\n", b"1\n", b"\xff\n", b"{}\nPK"])
def test_a_unit_with_another_content_is_played_again(folder, content):
    Units(folder, ".unit").keep("pushing-0", content)
    assert keys(folder) == REST


@pytest.mark.parametrize("kind", ["link", "pipe", "directory", "device", "terabyte"])
def test_what_is_not_a_plain_file_is_not_read_and_a_link_is_not_followed(folder, tmp_path, kind):
    whole = kept(folder)
    file, mine = folder / "pushing-0.unit", tmp_path / "mine"
    file.rename(mine)
    before = mine.read_bytes()
    {
        "link": lambda: file.symlink_to(mine),
        "pipe": lambda: os.mkfifo(file),
        "directory": file.mkdir,
        "device": lambda: file.symlink_to("/dev/zero"),
        "terabyte": lambda: (file.touch(), os.truncate(file, 2**40)),
    }[kind]()
    assert keys(folder) == REST
    if kind in ("pipe", "directory"):
        with pytest.raises(InfrastructureError, match=r"pushing-0\.unit cannot be written"):
            UnfinishedRun(folder.parent).keep(whole[0])
    else:
        UnfinishedRun(folder.parent).keep(whole[0])
        assert len(kept(folder)) == len(SPECS)
    assert mine.read_bytes() == before


def test_a_directory_in_the_place_of_a_file_is_said(folder):
    (folder / "playing-0.unit").mkdir()
    with pytest.raises(RunDirectoryError, match="unfinished cannot be removed"):
        UnfinishedRun(folder.parent).remove()


@pytest.mark.parametrize("kind", ["link", "file"])
def test_a_folder_that_is_a_link_or_a_file_is_refused(folder, tmp_path, kind):
    run, mine = tmp_path / "other", tmp_path / "mine"
    run.mkdir()
    mine.mkdir()
    if kind == "link":
        (run / UNFINISHED).symlink_to(mine)
    else:
        (run / UNFINISHED).touch()
    for use in (UnfinishedRun(run).begin, UnfinishedRun(run).check):
        with pytest.raises(RunDirectoryError, match="cannot be written: it is no directory"):
            use(HEADER, PACKAGES)
    UnfinishedRun(run).remove()
    assert list(mine.iterdir()) == []


def test_removing_leaves_what_is_not_a_run_s(folder):
    (folder / "notes.txt").write_text("mine")
    (folder / ".0123456789abcdef.partial").write_text("half")
    UnfinishedRun(folder.parent).remove()
    assert os.listdir(folder) == ["notes.txt"]


def test_a_full_disk_keeps_what_is_there(folder):
    record, *_ = kept(folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(InfrastructureError, match=r"pushing-0\.unit cannot be written"):
            UnfinishedRun(folder.parent).keep(record)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_it_is_on_disk_before_the_call_returns(folder, tmp_path, monkeypatch):
    record, synced, real = kept(folder)[0], [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(real(handle)))
    other = UnfinishedRun(tmp_path / "other")
    other.begin(HEADER, PACKAGES)
    other.keep(record)
    assert len(synced) == 2
