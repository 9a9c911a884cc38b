import base64
import json
import os
import shutil
import subprocess
import sys
import tracemalloc
import zlib
from pathlib import Path

import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.evaluation.journal import Journal, _framed, read_journal
from minitouch_bench.files import JOURNAL_FILE, MIB
from tests.evaluation.runs import digests

ROOT = Path(__file__).parents[2]


def bomb(size: int) -> str:
    """Return zeros, compressed as an array of a journal is, without holding them all."""
    pack = zlib.compressobj(9)
    parts = [pack.compress(bytes(min(size, MIB))) for _ in range(max(1, size // MIB))]
    return base64.b64encode(b"".join([*parts, pack.flush()])).decode()


@pytest.fixture
def copy(finished, tmp_path):
    """The finished run's journal, to be damaged."""
    shutil.copy(finished[1] / JOURNAL_FILE, tmp_path)
    return tmp_path / JOURNAL_FILE


def test_what_is_written_is_read(finished):
    run, directory = finished
    header, records, torn = read_journal(directory)
    assert header == run.header
    assert not torn
    assert {r.spec: r.trace.digest() for r in records} == {
        r.spec: r.trace.digest() for r in run.records
    }
    assert {(r.spec, r.outcome, r.fault) for r in records} == {
        (r.spec, r.outcome, r.fault) for r in run.records
    }


def test_a_torn_last_line_is_cut_wherever_it_is_torn(copy):
    content = copy.read_bytes()
    last = content.rindex(b"\n", 0, -1) + 1
    count = content.count(b"\n")
    for end in [*range(last, last + 200), *range(last, len(content), 97), len(content) - 1]:
        copy.write_bytes(content[:end])
        _, records, torn = read_journal(copy.parent)
        assert torn == (end > last)
        assert len(records) == count - 2
        assert copy.read_bytes() == content[:last]


def test_whatever_is_left_of_a_journal_is_read_or_refused(copy):
    content = copy.read_bytes()
    first = content.index(b"\n") + 1
    for end in range(0, len(content), 997):
        copy.write_bytes(content[:end])
        if end < first:
            with pytest.raises(RunDirectoryError, match="nothing that can be resumed"):
                read_journal(copy.parent)
        else:
            _, records, torn = read_journal(copy.parent)
            assert len(records) == content.count(b"\n", 0, end) - 1
            assert torn == (content[end - 1 : end] != b"\n")


@pytest.mark.parametrize("line", [1, 3])
@pytest.mark.parametrize("where", [0, 2, 12, 25, 60, -3])
def test_damage_before_the_end_is_refused_with_its_line(copy, line, where):
    lines = copy.read_bytes().splitlines(keepends=True)
    damaged = bytearray(lines[line - 1])
    damaged[where] ^= 0x04
    lines[line - 1] = bytes(damaged)
    copy.write_bytes(b"".join(lines))
    before = copy.read_bytes()
    with pytest.raises(RunDirectoryError, match=rf"line {line} is damaged"):
        read_journal(copy.parent)
    assert copy.read_bytes() == before


def test_a_line_of_another_version_is_refused(tmp_path):
    with Journal(tmp_path) as journal:
        journal._append({"format": "minitouch-journal", "version": 9})
    with pytest.raises(RunDirectoryError, match="line 1: object missing required field header"):
        read_journal(tmp_path)


@pytest.mark.parametrize(
    ("name", "array", "words"),
    [
        ("touch", ["<f4", [3, 11], bomb(2**28)], "does not have the size"),
        ("touch", ["<f4", [2**40, 11], bomb(10)], "declares an array of"),
        ("touch", ["<f4", [-1, -1], bomb(10)], "another kind"),
        ("touch", [",", [1], bomb(1)], "another kind"),
        ("touch", ["O", [1], bomb(8)], "another kind"),
        ("touch", ["<f4", [1], "?"], "is damaged"),
        ("touch", ["<f4", [1], "AAAA"], "is damaged"),
        ("touch", {"a": 1}, "expected"),
        ("ticks", None, "expected"),
    ],
)
def test_no_array_of_a_journal_takes_more_memory_than_an_episode(copy, name, array, words):
    lines = copy.read_bytes().splitlines(keepends=True)
    body = json.loads(lines[1])["body"]
    body["trace"][name] = array
    copy.write_bytes(lines[0] + _framed(json.dumps(body).encode()))
    tracemalloc.start()
    with pytest.raises(RunDirectoryError, match=words):
        read_journal(copy.parent)
    assert tracemalloc.get_traced_memory()[1] < 20 * MIB
    tracemalloc.stop()


@pytest.mark.parametrize("body", [b"[" * 100_000, b"[]", b"1", b'{"header": []}', b"\xff", b"{"])
def test_a_line_with_another_value_is_refused(copy, body):
    header = copy.read_bytes().splitlines(keepends=True)[0]
    for before in (b"", header):
        copy.write_bytes(before + _framed(body))
        with pytest.raises(RunDirectoryError, match="line"):
            read_journal(copy.parent)


def test_a_journal_of_a_terabyte_takes_no_memory(copy):
    with copy.open("r+b") as file:
        file.truncate(2**40)
    tracemalloc.start()
    with pytest.raises(RunDirectoryError, match="is damaged"):
        read_journal(copy.parent)
    assert tracemalloc.get_traced_memory()[1] < 20 * MIB
    tracemalloc.stop()


def test_an_episode_that_is_there_twice_is_refused(finished, copy):
    run = finished[0]
    specs = [record.spec for record in run.records]
    assert len(read_journal(copy.parent, lambda _: specs).records) == len(specs)
    with copy.open("ab") as file:
        file.write(copy.read_bytes().splitlines(keepends=True)[-1])
    with pytest.raises(RunDirectoryError, match="twice or of another run"):
        read_journal(copy.parent, lambda _: specs)


@pytest.mark.parametrize("kind", ["link", "pipe", "directory", "device"])
def test_a_journal_that_is_no_plain_file_is_neither_read_nor_written(tmp_path, kind):
    mine = tmp_path / "mine"
    mine.write_text("kept")
    journal = tmp_path / "run" / JOURNAL_FILE
    journal.parent.mkdir()
    {
        "link": lambda: journal.symlink_to(mine),
        "pipe": lambda: os.mkfifo(journal),
        "directory": journal.mkdir,
        "device": lambda: journal.symlink_to("/dev/zero"),
    }[kind]()
    with pytest.raises(RunDirectoryError, match="cannot be read"):
        read_journal(journal.parent)
    with pytest.raises(RunDirectoryError, match="cannot be written"):
        Journal(journal.parent)
    assert mine.read_text() == "kept"


def test_no_journal_is_refused(tmp_path):
    with pytest.raises(RunDirectoryError, match="cannot be read"):
        read_journal(tmp_path)


COPY = """
import resource, sys
from pathlib import Path
from minitouch_bench.errors import InfrastructureError
from minitouch_bench.evaluation.journal import Journal, read_journal
source, target, limit = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
header, records, _ = read_journal(source)
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
with Journal(target) as journal:
    journal.write_header(header)
    try:
        for record in records:
            journal.write_record(record)
    except InfrastructureError as error:
        print(error)
"""


@pytest.mark.parametrize("part", [0.5, 0.8])
def test_a_full_disk_leaves_a_good_journal(finished, tmp_path, part):
    run, directory = finished
    size = int((directory / JOURNAL_FILE).stat().st_size * part)
    command = [sys.executable, "-c", COPY, str(directory), str(tmp_path), str(size)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "cannot be written" in done.stdout
    header, records, torn = read_journal(tmp_path)
    assert header == run.header
    assert not torn
    written = [(r.spec.key, r.outcome, r.trace.digest()) for r in records]
    assert 0 < len(written) < len(run.records)
    assert set(written) < set(digests(run))


def test_it_is_on_disk_before_the_call_returns(finished, tmp_path, monkeypatch):
    synced = []
    real = os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(real(handle)))
    with Journal(tmp_path) as journal:
        journal.write_header(finished[0].header)
        journal.write_record(finished[0].records[0])
    assert len(synced) == 2


@pytest.mark.slow
def test_a_journal_cut_at_every_byte_is_read_or_refused(finished, tmp_path):
    directory = finished[1]
    lines = (directory / JOURNAL_FILE).read_bytes().splitlines(keepends=True)
    shortest = sorted(lines[1:], key=len)[:2]
    content = b"".join([lines[0], *shortest])
    for end in range(len(content) + 1):
        (tmp_path / JOURNAL_FILE).write_bytes(content[:end])
        whole = content.count(b"\n", 0, end)
        if whole == 0:
            with pytest.raises(RunDirectoryError, match="nothing that can be resumed"):
                read_journal(tmp_path)
            continue
        _, records, torn = read_journal(tmp_path)
        assert len(records) == whole - 1
        assert torn == (content[end - 1 : end] != b"\n")
        assert len((tmp_path / JOURNAL_FILE).read_bytes()) == content.rindex(b"\n", 0, end) + 1
