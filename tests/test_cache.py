from pathlib import Path

import pytest

from minitouch_bench.errors import InfrastructureError
from minitouch_bench.files import cache_directory, cache_file


def test_the_cache_follows_the_environment(monkeypatch):
    monkeypatch.delenv("MINITOUCH_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert cache_directory() == Path("/somewhere/minitouch-bench")
    monkeypatch.setenv("MINITOUCH_CACHE", "/elsewhere")
    assert cache_directory() == Path("/elsewhere")


def test_a_damaged_file_is_written_again(tmp_path, monkeypatch):
    monkeypatch.setenv("MINITOUCH_CACHE", str(tmp_path))
    path = cache_file("thing", ".urdf", b"content")
    path.write_bytes(b"damaged")
    assert cache_file("thing", ".urdf", b"content") == path
    assert path.read_bytes() == b"content"
    assert cache_file("thing", ".urdf", b"other") != path


def test_a_cache_that_cannot_be_written_says_what_to_do(tmp_path, monkeypatch):
    (tmp_path / "file").touch()
    monkeypatch.setenv("MINITOUCH_CACHE", str(tmp_path / "file" / "cache"))
    with pytest.raises(InfrastructureError, match="MINITOUCH_CACHE"):
        cache_file("thing", ".urdf", b"content")
