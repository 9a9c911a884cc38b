"""Locks, whole-file writes and careful reads, tried as crashes and strangers would."""

import errno
import os
import subprocess
import sys
import threading
import tracemalloc
from pathlib import Path

import pytest

from minitouch_bench.errors import InfrastructureError, RunDirectoryError
from minitouch_bench.files import (
    GIB,
    KIB,
    LOCK_FILE,
    MIB,
    RUN_FILES,
    append_bytes,
    cache_directory,
    cache_file,
    clear_run,
    holds_run,
    lock_directory,
    read_file,
    write_file,
)
from tests.process_tree import WITHOUT_LOCKS, run_python

HOLD = """
import sys, time
from pathlib import Path
from minitouch_bench.files import lock_directory
with lock_directory(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(1000)
"""


def test_a_directory_is_held_by_one_until_it_ends_in_whatever_way_and_can_be_waited_for(tmp_path):
    directory = tmp_path / "new" / "run"
    command = [sys.executable, "-c", HOLD, str(directory)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(RunDirectoryError, match="in use by another"), lock_directory(directory):
            pass
        holder.kill()
    directory, order = tmp_path / "left empty", []

    def wait():
        with lock_directory(directory, wait=True):
            order.append("second")

    with lock_directory(directory):
        waiting = threading.Thread(target=wait, daemon=True)
        waiting.start()
        waiting.join(0.2)
        order.append("first")
    waiting.join(60)
    assert order == ["first", "second"]
    assert not directory.exists()


def test_clearing_removes_the_run_and_nothing_else(tmp_path):
    for name in (*RUN_FILES, "notes.txt", "policy.pt"):
        (tmp_path / name).write_text("x")
    views = ("videos/pushing-0.mp4", "videos/mine.mp4", "other/a.mp4", "replays/opening-1.html")
    for name in views:
        write_file(tmp_path / name, "x")
    assert holds_run(tmp_path)
    clear_run(tmp_path)
    clear_run(tmp_path)
    assert not holds_run(tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["notes.txt", "other", "policy.pt", "videos"]
    assert os.listdir(tmp_path / "videos") == ["mine.mp4"]


# Locks


def test_a_lock_leaves_nothing_and_clears_what_a_killed_writer_left(tmp_path):
    (tmp_path / "videos").mkdir()
    for folder in (tmp_path, tmp_path / "videos"):
        (folder / ".0123456789abcdef.partial").write_text("half")
    (tmp_path / ".partial").mkdir()
    (tmp_path / ".of-the-user.partial").write_text("kept")
    kept = [".of-the-user.partial", ".partial", "videos"]
    with lock_directory(tmp_path):
        assert sorted(os.listdir(tmp_path)) == [LOCK_FILE, *kept]
    assert sorted(os.listdir(tmp_path)) == kept
    assert not os.listdir(tmp_path / "videos")


def test_a_lock_ends_where_a_part_cannot_be_removed_and_is_no_other_s(tmp_path):
    (tmp_path / ".0123456789abcdef.partial").mkdir()
    for _ in range(2):
        with pytest.raises(RunDirectoryError, match="cannot be written"), lock_directory(tmp_path):
            pass
    held = tmp_path / "held"
    with lock_directory(held):
        held.rename(tmp_path / "moved")
        with lock_directory(held):
            assert (held / LOCK_FILE).exists()
    with lock_directory(held):
        (held / LOCK_FILE).unlink()
        (held / LOCK_FILE).touch()
    assert (held / LOCK_FILE).exists()


def test_who_waited_at_a_removed_lock_does_not_hold_the_directory(tmp_path, monkeypatch):
    real, stale = os.open, []

    def opened_too_early(path, *arguments):
        handle = real(path, *arguments)
        if not stale:
            stale.append(handle)
            os.unlink(path)  # its holder ends between our open and our lock
            os.close(real(path, *arguments))  # and the next one has made another
        return handle

    monkeypatch.setattr(os, "open", opened_too_early)
    with lock_directory(tmp_path), pytest.raises(RunDirectoryError), lock_directory(tmp_path):
        pass


LOCK_TWICE = f"""
import sys
from pathlib import Path
from minitouch_bench.files import lock_directory
{WITHOUT_LOCKS}
with lock_directory(Path(sys.argv[1])), lock_directory(Path(sys.argv[1])):
    print("held")
"""


def test_a_file_system_without_locks_is_used_with_a_note_and_another_error_is_one(tmp_path):
    for number in (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP):
        done = run_python("-c", LOCK_TWICE, number, tmp_path)
        assert done.stdout == "held\n"
        assert os.strerror(number) in done.stderr
        assert done.stderr.startswith(f"{tmp_path}: ")
        assert not os.listdir(tmp_path)
    assert "Input/output error" in run_python("-c", LOCK_TWICE, errno.EIO, tmp_path, code=1).stderr


# Writing


@pytest.mark.parametrize("plant", [Path.symlink_to, Path.hardlink_to])
def test_a_file_is_written_whole_and_nothing_is_written_or_added_through_a_link(tmp_path, plant):
    target = tmp_path / "target"
    write_file(target, "kept")
    path = tmp_path / "new" / "report.md"
    write_file(path, "ä\n")
    assert path.read_bytes() == "ä\n".encode()
    path.unlink()
    plant(path, target)
    with pytest.raises(RunDirectoryError):
        append_bytes(path, b"more")
    write_file(path, b"again")
    assert not path.is_symlink()
    assert path.read_bytes() == b"again"
    assert target.read_text() == "kept"
    assert os.listdir(path.parent) == ["report.md"]


def test_a_file_that_cannot_be_written_whole_leaves_the_old_one(tmp_path):
    path = tmp_path / "file"
    write_file(path, b"old")
    code = (
        "import resource, sys; from pathlib import Path; "
        "from minitouch_bench.files import write_file; "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000)); "
        "write_file(Path(sys.argv[1]), bytes(5000))"
    )
    done = run_python("-c", code, path, code=1)
    assert f"RunDirectoryError: {path} cannot be written: File too large\n" in done.stderr
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["file"]


def test_a_pipe_in_the_place_of_a_file_is_neither_written_to_nor_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # a writer that opened it would wait for ever
    with pytest.raises(RunDirectoryError, match="it is no plain file"):
        write_file(tmp_path / "pipe", "text")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    write_file(tmp_path / "link", "text")
    assert (tmp_path / "link").read_text() == "text"
    assert (tmp_path / "pipe").is_fifo()


# Reading


def test_what_is_no_plain_file_is_not_read_and_a_link_only_where_that_is_asked_for(tmp_path):
    (tmp_path / "file").write_text("content")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    os.mkfifo(tmp_path / "pipe")  # a reader that opened it would wait for ever
    for name, word in (("link", "a symbolic link"), ("pipe", "no plain"), (".", "Is a directory")):
        with pytest.raises(OSError, match=word):
            read_file(tmp_path / name)
    assert read_file(tmp_path / "link", follow=True) == b"content"


@pytest.mark.parametrize(("limit", "words"), [(3 * MIB, "3 MiB"), (2 * KIB, "2 KiB")])
def test_a_file_over_its_limit_is_refused_without_being_read(tmp_path, limit, words):
    path = tmp_path / "file"
    path.write_bytes(bytes(limit))
    assert read_file(path, limit) == bytes(limit)
    with path.open("r+b") as file:
        file.truncate(2**40)  # a sparse terabyte
    with pytest.raises(OSError, match=f"it is larger than {words}"):
        read_file(path, limit)
    tracemalloc.start()
    with pytest.raises(OSError, match="it is larger than 1024 MiB"):
        read_file(path, GIB)
    assert tracemalloc.get_traced_memory()[1] < KIB * KIB
    tracemalloc.stop()


# The cache


def test_the_cache_follows_the_environment(monkeypatch):
    monkeypatch.delenv("MINITOUCH_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert cache_directory() == Path("/somewhere/minitouch-bench")
    monkeypatch.setenv("MINITOUCH_CACHE", "/elsewhere")
    assert cache_directory() == Path("/elsewhere")
    monkeypatch.setenv("HOME", "/home/of-somebody")
    monkeypatch.setenv("MINITOUCH_CACHE", "~/elsewhere")
    assert cache_directory() == Path("/home/of-somebody/elsewhere")


HOMELESS = """
import os, sys
for name in ("HOME", "XDG_CACHE_HOME", "MINITOUCH_CACHE"):
    os.environ.pop(name, None)
os.getuid = lambda: 2**31 - 5  # /etc/passwd lacks it, as that of a container lacks its user
from minitouch_bench.__main__ import main
main()
"""


@pytest.mark.parametrize("command", [("record", "random"), ("train",)])
def test_without_a_home_directory_a_line_says_what_to_set(tmp_path, command):
    done = run_python("-c", HOMELESS, *command, "pushing", "--output", tmp_path / "new", code=5)
    assert "MINITOUCH_CACHE" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_damaged_file_is_written_again_and_the_error_of_a_cache_says_what_to_do(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("MINITOUCH_CACHE", str(tmp_path))
    path = cache_file("thing", ".urdf", b"content")
    path.write_bytes(b"damaged")
    assert cache_file("thing", ".urdf", b"content") == path
    assert path.read_bytes() == b"content"
    assert cache_file("thing", ".urdf", b"other") != path
    monkeypatch.setenv("MINITOUCH_CACHE", str(path / "cache"))
    with pytest.raises(InfrastructureError, match="MINITOUCH_CACHE"):
        cache_file("thing", ".urdf", b"content")
