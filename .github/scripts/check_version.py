"""Exit 1 unless a tag is "v" and the version in pyproject.toml: ``check_version.py v1.0.0``."""

import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def main() -> int:
    """Compare the tag with the version."""
    tag = sys.argv[1]
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    if tag != f"v{version}":
        print(f"the tag is {tag}, the version in pyproject.toml is {version}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
