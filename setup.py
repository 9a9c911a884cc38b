"""Put the canonical shape set, which lives in shapes/ at the top level, into the wheel too."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

SET = Path("shapes/minitouch-1000")


class BuildWithShapes(build_py):
    """Copy the set beside the modules; an editable install reads it from the checkout."""

    def run(self) -> None:
        """Build as usual, then copy."""
        super().run()
        if not self.editable_mode:
            target = Path(self.build_lib) / "minitouch_bench" / SET
            shutil.copytree(SET, target, dirs_exist_ok=True, ignore=shutil.ignore_patterns(".*"))


setup(cmdclass={"build_py": BuildWithShapes})
