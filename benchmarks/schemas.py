"""Write the published schemas from the types: ``make schemas``."""

import json
from pathlib import Path

from minitouch_bench.leaderboard.board import board_schema
from minitouch_bench.leaderboard.submission import submission_schema
from minitouch_bench.runs.schema import run_schema

DOCS = Path(__file__).parent.parent / "docs"
SCHEMAS = {"run": run_schema, "submission": submission_schema, "leaderboard": board_schema}


def main() -> None:
    for name, schema in SCHEMAS.items():
        text = json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"
        (DOCS / f"{name}.schema.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
