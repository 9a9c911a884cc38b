"""The scripts that workflows call, imported from ``.github/scripts``."""

import importlib.util
from types import ModuleType

from tests.altered import ROOT

SCRIPTS = ROOT / ".github" / "scripts"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
