import errno
import os

import pytest

import minitouch_bench as mt
from minitouch_bench import files
from minitouch_bench.errors import InfrastructureError


@pytest.mark.parametrize("name", [files.ACTIONS_FILE, files.RUN_FILE])
def test_a_disk_that_is_full_at_the_end_loses_nothing(tmp_path, monkeypatch, name):
    def evaluate(**options):
        return mt.evaluate("zero", tasks="opening", episodes=1, output=tmp_path / "run", **options)

    replace_file = files.replace_file

    def full(path, content, *, durable=True):
        if path.name == name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace_file(path, content, durable=durable)

    with monkeypatch.context() as patch:
        patch.setattr(files, "replace_file", full)
        with pytest.raises(InfrastructureError, match=r"No space left on device\nWhat .*--resume"):
            evaluate()
    assert (tmp_path / "run" / files.JOURNAL_FILE).read_bytes().count(b"\n") == 1
    assert len(evaluate(resume=True).episodes) == 1
