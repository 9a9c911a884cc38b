"""Exit 1 unless a tag is "v" and the version in pyproject.toml: ``check_version.py v1.0.0``.

The account that publishes must be set, too: OWNER in pyproject.toml is a placeholder.
"""

import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]


def main() -> int:
    """Compare the tag with the version."""
    tag = sys.argv[1]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    version = project["version"]
    if tag != f"v{version}":
        print(f"the tag is {tag}, the version in pyproject.toml is {version}", file=sys.stderr)
        return 1
    if "OWNER" in project["urls"]["Repository"].split("/"):
        print('OWNER is not set: CONTRIBUTING.md, "Before the first release"', file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
