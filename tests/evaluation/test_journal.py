"""The journal of an unfinished run: an episode is kept whole, or it is played again."""

import os
import resource
import shutil
import subprocess
import sys

import pytest

from minitouch_bench.errors import InfrastructureError, RunDirectoryError
from minitouch_bench.evaluation.run import header_of, package_versions
from minitouch_bench.files import JOURNAL_FILE
from minitouch_bench.metrics.summary import measure
from minitouch_bench.runs.journal import Journal
from tests.evaluation.runs import request

REQUEST = request()
SPECS = REQUEST.plan.specs()
HEADER, PACKAGES = header_of(REQUEST), package_versions()
KEYS = [spec.key for spec in SPECS]


@pytest.fixture
def journal(finished, tmp_path):
    """The journal of the finished run, as it was before the run was finished."""
    shutil.copy(finished[1] / JOURNAL_FILE, tmp_path)
    return Journal(tmp_path)


def keys(journal):
    return [record.spec.key for record in journal.records(SPECS)]


def test_what_is_kept_is_read(finished, journal):
    journal.check(HEADER, PACKAGES)
    records = journal.records(SPECS)
    assert tuple(map(measure, records)) == finished[0].episodes
    assert [record.spec for record in records] == list(SPECS)


def test_the_order_is_that_of_the_episodes_asked_for(journal):
    records = journal.records(SPECS[::-1])
    assert [record.spec.key for record in records] == KEYS[::-1]
    assert journal.records(request(seed=1).plan.specs()) == ()


def test_a_cut_journal_loses_its_last_episode_and_no_later_one(journal):
    content = journal.path.read_bytes()
    last = journal.records(SPECS)[-1]
    start = content.rindex(b"\n")
    for end in [*range(start, start + 80), *range(start, len(content), 997), len(content) - 1]:
        journal.path.write_bytes(content[:end])
        assert keys(journal) == KEYS[:-1]
        journal.keep(last)
        assert keys(journal) == KEYS


def test_a_line_with_another_bit_costs_one_episode(journal):
    content = journal.path.read_bytes()
    start = content.index(b"\n") + 1
    end = content.index(b"\n", start)
    for place in [*range(start, start + 80), *range(start, end, 997), end - 1]:
        damaged = bytearray(content)
        damaged[place] ^= 0x04
        journal.path.write_bytes(damaged)
        assert keys(journal) == KEYS[1:]


@pytest.mark.parametrize("content", [b"", b"\n", b"00000000 {}", b"\xff" * 100])
def test_episodes_without_their_header_are_refused(journal, content):
    _, _, episodes = journal.path.read_bytes().partition(b"\n")
    journal.path.write_bytes(content + b"\n" + episodes)
    with pytest.raises(RunDirectoryError, match=rf"{JOURNAL_FILE} has no header.*--fresh"):
        journal.check(HEADER, PACKAGES)


@pytest.mark.parametrize("kind", ["directory", "link", "pipe"])
def test_what_is_not_a_plain_file_is_said(journal, tmp_path, kind):
    record, mine = journal.records(SPECS)[0], tmp_path / "mine"
    journal.path.rename(mine)
    before = mine.read_bytes()
    {
        "directory": journal.path.mkdir,
        "link": lambda: journal.path.symlink_to(mine),
        "pipe": lambda: os.mkfifo(journal.path),
    }[kind]()
    with pytest.raises(InfrastructureError, match=f"{JOURNAL_FILE} cannot be written"):
        journal.keep(record)
    with pytest.raises(RunDirectoryError, match=f"{JOURNAL_FILE} cannot be read"):
        journal.check(HEADER, PACKAGES)
    assert mine.read_bytes() == before


def test_a_full_disk_keeps_what_is_there_and_room_again_is_used(journal):
    last = journal.records(SPECS)[-1]
    content = journal.path.read_bytes()
    journal.path.write_bytes(content[: content.rindex(b"\n")])
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (journal.path.stat().st_size + 1000, hard))
    try:
        with pytest.raises(InfrastructureError, match=f"{JOURNAL_FILE} cannot be written"):
            journal.keep(last)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert keys(journal) == KEYS[:-1]
    journal.keep(last)
    assert keys(journal) == KEYS


KEEP = """
import sys
from pathlib import Path
from minitouch_bench.runs.journal import Journal
from tests.evaluation.test_journal import SPECS
source, target = (Journal(Path(name)) for name in sys.argv[1:])
records = source.records(SPECS)
print("begun", flush=True)
while True:
    for record in records:
        target.keep(record)
"""


def test_a_killed_writer_leaves_whole_episodes(journal, tmp_path):
    target = Journal(tmp_path / "target")
    target.begin(HEADER, PACKAGES)
    root = os.path.abspath(f"{__file__}/../../..")
    for _ in range(3):
        writer = subprocess.Popen(
            [sys.executable, "-c", KEEP, tmp_path, target.path.parent],
            env={**os.environ, "PYTHONPATH": root},
            stdout=subprocess.PIPE,
        )
        before = target.path.stat().st_size
        assert writer.stdout.readline() == b"begun\n"
        while target.path.stat().st_size < before + 100_000:
            pass
        writer.kill()
        writer.communicate()
        target.check(HEADER, PACKAGES)
        assert keys(target) == KEYS


def test_an_episode_is_on_disk_before_the_call_returns(journal, monkeypatch):
    record, synced, real = journal.records(SPECS)[0], [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(real(handle)))
    journal.begin(HEADER, PACKAGES)
    journal.keep(record)
    assert len(synced) == 2


def test_a_journal_that_cannot_be_removed_is_said(tmp_path):
    journal = Journal(tmp_path)
    journal.remove()
    journal.path.mkdir()
    with pytest.raises(RunDirectoryError, match="cannot be removed"):
        journal.remove()
