import io
import os
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from minitouch_bench.episode import EpisodeSpec, Role
from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import ACTIONS_FILE
from minitouch_bench.runs.actions import ENTRY_MARK, parse_actions, write_actions
from tests.archives import zipped
from tests.reporting.synthetic import make_run

RECORDS = make_run(tasks=("pushing", "opening"), episodes=2).records


def read_actions(directory, specs):
    return parse_actions((directory / ACTIONS_FILE).read_bytes(), specs, ACTIONS_FILE)


def test_actions_are_those_of_the_records(tmp_path):
    write_actions(RECORDS, tmp_path)
    actions = read_actions(tmp_path, [record.spec for record in RECORDS])
    assert [*actions] == [record.spec.key for record in RECORDS]
    for record in RECORDS:
        assert actions[record.spec.key].tobytes() == record.trace.actions.tobytes()
    assert os.listdir(tmp_path) == [ACTIONS_FILE]


SPECS = tuple(EpisodeSpec(Role.FINAL, "pushing", index, 1) for index in range(2))
GOOD = np.zeros((3, 4), np.float32)


class Boom:
    def __reduce__(self):
        return os.mkdir, ("executed",)


@pytest.mark.parametrize(
    ("array", "words"),
    [
        (np.full((3, 4), 1.001, np.float32), "beyond -1 to 1"),
        (np.zeros((3, 5), np.float32), r"not float32 \(T, 4\)"),
        (np.zeros((201, 4), np.float32), "0 to 200 actions"),
        (np.array([Boom()], object), "another kind"),
        (np.zeros(10_000_000, np.float32), "declares 40000128 bytes"),
    ],
)
def test_what_are_no_actions_is_refused_before_it_is_unpacked(tmp_path, monkeypatch, array, words):
    monkeypatch.chdir(tmp_path)
    np.savez_compressed(tmp_path / ACTIONS_FILE, **{"pushing/0": array})
    with pytest.raises(RunDirectoryError, match=words):
        read_actions(tmp_path, SPECS)
    assert not Path("executed").exists()


def test_a_false_header_is_refused_and_takes_no_memory(tmp_path):
    text = b"{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000, 4), }"
    header = b"\x93NUMPY\x01\x00" + (118).to_bytes(2, "little") + text.ljust(117) + b"\n"
    (tmp_path / ACTIONS_FILE).write_bytes(zipped({"pushing/0.npy": header + bytes(64)}))
    with pytest.raises(RunDirectoryError, match="damaged"):
        read_actions(tmp_path, SPECS)


def test_episodes_that_are_not_of_the_run_are_refused(tmp_path):
    np.savez(tmp_path / ACTIONS_FILE, **{"pushing/0": GOOD, "../evil\x1b": GOOD})
    with pytest.raises(RunDirectoryError, match=r"'\.\./evil\\x1b', which is not an episode"):
        read_actions(tmp_path, SPECS)


def test_a_file_that_is_cut_or_debris_is_refused(tmp_path):
    np.savez_compressed(tmp_path / ACTIONS_FILE, **{"pushing/0": GOOD, "pushing/1": GOOD})
    content = (tmp_path / ACTIONS_FILE).read_bytes()
    for end in range(0, len(content) - 1, 7):
        (tmp_path / ACTIONS_FILE).write_bytes(content[:end])
        with pytest.raises(RunDirectoryError, match="damaged"):
            read_actions(tmp_path, SPECS)


def test_an_array_that_is_longer_than_it_declares_is_not_unpacked(tmp_path):
    whole = io.BytesIO()
    np.save(whole, np.zeros(64 * 2**20, np.uint8))
    content = bytearray(zipped({"pushing/0.npy": whole.getvalue()}, zipfile.ZIP_DEFLATED))
    for size in (22, content.index(ENTRY_MARK) + 24):
        content[size : size + 4] = (200_000).to_bytes(4, "little")
    (tmp_path / ACTIONS_FILE).write_bytes(content)
    tracemalloc.start()
    with pytest.raises(RunDirectoryError, match="damaged"):
        read_actions(tmp_path, SPECS)
    assert tracemalloc.get_traced_memory()[1] < 8 * 2**20
    tracemalloc.stop()
