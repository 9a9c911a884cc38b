"""The journal of an unfinished run: an episode is kept whole, or it is played again."""

import os
import resource
import tracemalloc
import zlib
from dataclasses import replace

import numpy as np
import pytest

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import JOURNAL_FILE
from minitouch_bench.metrics.summary import measure
from minitouch_bench.runs.journal import Journal
from tests.reporting.synthetic import make_run

PLAYED = make_run(tasks=("pushing", "opening", "pick-up"), episodes=2, exploration=False)
HEADER, PACKAGES, RECORDS = PLAYED.header, PLAYED.environment.packages, PLAYED.records
SPECS = HEADER.specs()
KEYS = [spec.key for spec in SPECS]


def resumed(directory):
    return Journal.resume(HEADER, PACKAGES, directory)


@pytest.fixture
def journal(tmp_path):
    """The journal of a run whose episodes are all played."""
    begun = Journal.begin(HEADER, PACKAGES, tmp_path)
    for record in RECORDS:
        begun.keep(record)
    return resumed(tmp_path)


@pytest.fixture
def path(journal):
    return journal.directory / JOURNAL_FILE


def keys(path):
    return [spec.key for spec in resumed(path.parent).records]


def test_what_is_kept_is_read_in_the_order_of_the_plan(path):
    first, *lines = path.read_bytes().split(b"\n")
    path.write_bytes(b"\n".join([first, *lines[::-1]]))
    records = resumed(path.parent).records
    assert [*map(measure, records.values())] == [*map(measure, RECORDS)]
    assert list(records) == list(SPECS)
    assert [record.spec for record in records.values()] == list(SPECS)


def test_a_new_suite_of_the_protocol_stops_no_run_of_the_others(path):
    header = replace(HEADER, protocol_digest="0" * 64)
    assert Journal.resume(header, PACKAGES, path.parent).records.keys() == {*SPECS}
    with pytest.raises(RunDirectoryError, match="official"):
        Journal.resume(replace(header, official=not header.official), PACKAGES, path.parent)


def test_a_cut_journal_loses_its_last_episode_and_no_later_one(journal, path):
    content = path.read_bytes()
    last = journal.records[SPECS[-1]]
    start = content.rindex(b"\n")
    for end in [*range(start, start + 80), *range(start, len(content), 997), len(content) - 1]:
        path.write_bytes(content[:end])
        assert keys(path) == KEYS[:-1]
        journal.keep(last)
        assert keys(path) == KEYS


def test_a_line_with_another_bit_costs_one_episode(journal, path):
    content = path.read_bytes()
    start = content.index(b"\n") + 1
    end = content.index(b"\n", start)
    for place in [*range(start, start + 80), *range(start, end, 997), end - 1]:
        damaged = bytearray(content)
        damaged[place] ^= 0x04
        path.write_bytes(damaged)
        assert keys(path) == KEYS[1:]


def test_a_whole_line_of_damaged_arrays_is_refused(path):
    first, line, *_ = path.read_bytes().split(b"\n")
    text = line[9:].replace(b"UEs", b"AAA")  # "PK" of a zip file in base64
    path.write_bytes(first + b"\n%08x " % zlib.crc32(text) + text)
    with pytest.raises(RunDirectoryError, match=rf"{JOURNAL_FILE} is damaged"):
        resumed(path.parent)


def test_only_planned_episodes_are_unpacked(tmp_path):
    journal = Journal.begin(HEADER, PACKAGES, tmp_path)
    large = replace(RECORDS[0].trace, touch=np.zeros((2**12, 11), np.float32))
    for index in range(50):
        other = replace(SPECS[0], index=1000 + index)
        journal.keep(replace(RECORDS[0], spec=other, trace=large))
    journal.keep(RECORDS[0])
    size = large.touch.nbytes
    tracemalloc.start()
    try:
        assert [*resumed(tmp_path).records] == [SPECS[0]]
        assert tracemalloc.get_traced_memory()[1] < 20 * size
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("content", [b"", b"00000000 {}", b"\xff" * 100])
def test_episodes_without_their_header_are_refused(path, content):
    _, _, episodes = path.read_bytes().partition(b"\n")
    path.write_bytes(content + b"\n" + episodes)
    with pytest.raises(RunDirectoryError, match=rf"{JOURNAL_FILE} has no header"):
        resumed(path.parent)


def test_a_full_disk_keeps_what_is_there_and_room_again_is_used(journal, path):
    last = journal.records[SPECS[-1]]
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(b"\n")])
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + 1000, hard))
    try:
        with pytest.raises(RunDirectoryError, match=f"{JOURNAL_FILE} cannot be written"):
            journal.keep(last)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert keys(path) == KEYS[:-1]
    journal.keep(last)
    assert keys(path) == KEYS


def test_an_episode_is_on_disk_before_the_call_returns(journal, monkeypatch):
    record, synced, real = journal.records[SPECS[0]], [], os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: synced.append(real(handle)))
    Journal.begin(HEADER, PACKAGES, journal.directory).keep(record)
    assert len(synced) == 2
