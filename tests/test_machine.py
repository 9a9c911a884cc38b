import code
import platform
import re
import shlex

import pytest

from minitouch_bench import machine
from minitouch_bench.errors import MissingExtraError, PolicyLoadError
from tests.altered import ROOT

CPUINFO = """processor\t: 0
model name\t: Some Processor: 3 GHz
flags\t\t: fpu avx2
flags of another kind : avx512f

processor\t: 1
model name\t: Another
"""


def test_the_first_processor_is_named_with_its_features_or_else_the_architecture(
    tmp_path, monkeypatch
):
    file = tmp_path / "cpuinfo"
    monkeypatch.setattr(machine, "CPUINFO", file)
    for _ in range(2):
        assert machine.machine_facts()["processor"] == platform.machine()
        assert machine.processor_flags() == frozenset()
        file.write_text("processor : 0\n")
    file.write_text(CPUINFO)
    assert machine.machine_facts()["processor"] == "Some Processor: 3 GHz"
    assert machine.processor_flags() == {"fpu", "avx2"}


def test_a_missing_package_names_what_an_index_has_and_the_extra():
    with pytest.raises(MissingExtraError) as missing:
        machine.require("no_such_package", "onnx")
    assert "pip install 'onnx>=" in str(missing.value)
    constraints = shlex.quote(str(ROOT / "constraints.txt"))
    assert f" --constraint {constraints} (the" in str(missing.value)
    assert "(the extra minitouch-bench[onnx])" in str(missing.value)


def test_a_module_that_hides_another_of_its_name_is_named_by_its_path():
    with pytest.raises(PolicyLoadError, match=re.escape(code.__file__)):
        machine.look_up("code:Policy")
