import pytest

from minitouch_bench import optional
from minitouch_bench.errors import MissingExtraError


def test_a_missing_package_names_what_an_index_has_and_the_extra():
    with pytest.raises(MissingExtraError) as missing:
        optional.require("no_such_package", "onnx")
    assert "pip install 'onnx>=" in str(missing.value)
    assert "(the extra minitouch-bench[onnx])" in str(missing.value)


def test_where_nothing_is_installed_the_extra_is_named(monkeypatch):
    def requires(_):
        raise optional.PackageNotFoundError

    monkeypatch.setattr(optional, "requires", requires)
    with pytest.raises(MissingExtraError, match=r"pip install 'minitouch-bench\[onnx\]'"):
        optional.require("no_such_package", "onnx")
