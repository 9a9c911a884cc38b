"""Check the submission of a pull request, or play a row after a merge.

::

    submissions.py check --clone DIR --base SHA --head SHA --output DIR
    submissions.py names --base SHA --head SHA [--name NAME]
    submissions.py play --name NAME [--stop-after 5h]

``check`` takes ``submissions/NAME/`` from the clone, checks it with this environment's program, and
plays a few episodes with each of its trainings. The change may be in one submission's directory and
nowhere else. It writes ``result.json`` and ``output.txt`` for ``post_report.py``. ``names`` prints
the submissions that changed in this clone, or the one that is named. ``play`` plays the row of one
into ``played/``; what was played of it before is kept.
"""

import argparse
import json
import os
import re
import secrets
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
COMMAND = (sys.executable, "-m", "minitouch_bench")

OUTCOMES = {
    0: "sound", 1: "refused", 3: "refused", 4: "sound, with policy faults", 5: "not finished",
}  # fmt: skip
"""What the exit codes of the commands mean; any other end is a fault of the program."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
MAX_OUTPUT = 20_000
"""The last bytes of the program's output that are kept: ``post_report.py`` posts so many."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what is asked for; return the exit code."""
    parser = argparse.ArgumentParser()
    parser.add_argument("action", choices=("check", "names", "play"))
    parser.add_argument("--clone", type=Path, default=ROOT)
    parser.add_argument("--base", default="")
    parser.add_argument("--head", default="HEAD")
    parser.add_argument("--name", default="")
    parser.add_argument("--stop-after", default="5h")
    parser.add_argument("--output", type=Path, default=Path("checked"))
    given = parser.parse_args(arguments)
    if given.action == "play":
        return play(given.name, given.clone, given.stop_after)
    names, other = (
        ([given.name], []) if given.name else changed(given.clone, given.base, given.head)
    )
    present = [name for name in names if (given.clone / "submissions" / name).is_dir()]
    if given.action == "names":
        sound = [name for name in present if NAME.fullmatch(name)]
        print(f"names={json.dumps(sound)}")
        return 2 if given.name and not sound else 0
    given.output.mkdir(parents=True, exist_ok=True)
    if other or len(names) != 1 or not present:
        named = ", ".join(map(repr, [*names, *other][:10])) or "no file of a submission"
        text = f"A submission changes submissions/NAME/ and nothing else; this changes: {named}"
        report(text, dict.fromkeys(names, "not checked"), given.head, given.output)
        return 1
    outcome, text = check(names[0], given.clone)
    report(text, {names[0]: outcome}, given.head, given.output)
    return 0 if outcome.startswith("sound") else 1


def changed(clone: Path, base: str, head: str) -> tuple[list[str], list[str]]:
    """Return the submissions that changed since the base, removed ones too, and other paths."""
    if base.strip("0"):
        listing = ("diff", "--name-only", "--no-renames", "-z", f"{base}...{head}")
    else:  # a first push has no base
        listing = ("ls-tree", "-r", "--name-only", "-z", head)
    command = ("git", "-C", str(clone), *listing)
    text = subprocess.run(command, check=True, capture_output=True).stdout
    names, other = set(), []
    for path in text.decode("utf-8", "backslashreplace").split("\0"):
        parts = path.split("/")
        if len(parts) > 2 and parts[0] == "submissions" and NAME.fullmatch(parts[1]):
            names.add(parts[1])
        elif path:
            other.append(path)
    return sorted(names), other


def check(name: str, clone: Path) -> tuple[str, str]:
    """Check a copy of one submission with this environment's program, and play a few episodes."""
    with tempfile.TemporaryDirectory() as folder:
        submissions = Path(folder) / "submissions"
        shutil.copytree(clone / "submissions" / name, submissions / name, symlinks=True)
        code, text = run((*COMMAND, "leaderboard", "check", name), Path(folder))
        if code == 0:
            facts = tomllib.loads((submissions / name / "submission.toml").read_text())
            suites = facts.get("suites", ["table4"])
            suite = ("smoke",) if "table4" in suites else (suites[0], "--episodes", "5")
            for training in facts["trainings"]:
                policy = f"submissions/{name}/seed-{training['seed']}"
                ended, more = run((*COMMAND, "evaluate", policy, "--suite", *suite), Path(folder))
                text += more
                code = ended or code
                if not OUTCOMES.get(code, "").startswith("sound"):
                    break
    return OUTCOMES.get(code, f"the check failed with exit code {code}"), text


def play(name: str, clone: Path, stop_after: str) -> int:
    """Go on with the row in ``played/``; with the committed one, if that has draws of its own."""
    before, row = (clone / place / name for place in ("reports/results", "played"))
    known = draws(row, "draws") + draws(row, "retired")
    if any(draw not in known for draw in draws(before, "draws")):
        shutil.rmtree(row, ignore_errors=True)
        shutil.copytree(before, row)
    options = ("--results", "played", "--stop-after", stop_after)
    return run((*COMMAND, "leaderboard", "play", name, *options), clone)[0]


def draws(row: Path, key: str) -> list[object]:
    """Return the draws of a row, those in force or those that are retired."""
    file = row / "row.toml"
    return list(tomllib.loads(file.read_text()).get(key, [])) if file.exists() else []


def run(command: Sequence[str], folder: Path) -> tuple[int, str]:
    """Run a command; return its exit code and what it printed."""
    done = subprocess.run(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
    )
    text = done.stdout.decode("utf-8", "backslashreplace")
    token = secrets.token_hex(16)  # until it is repeated the runner obeys no line of the text
    print(f"::stop-commands::{token}\n{text}\n::{token}::", flush=True)
    return done.returncode, text


def report(text: str, outcomes: dict[str, str], head: str, output: Path) -> None:
    """Write the files of the report, and the job's summary."""
    text = text.encode()[-MAX_OUTPUT:].decode(errors="ignore")
    (output / "result.json").write_text(json.dumps({"head": head, "outcomes": outcomes}) + "\n")
    (output / "output.txt").write_text(text, encoding="utf-8")
    if summary := os.environ.get("GITHUB_STEP_SUMMARY"):
        rows = "".join(f"| `{name}` | {outcome} |\n" for name, outcome in outcomes.items())
        indented = "\n".join(f"    {line}" for line in text.splitlines())  # a block of code
        with Path(summary).open("a", encoding="utf-8") as file:
            file.write(f"| Submission | Outcome |\n|---|---|\n{rows}\n{indented}\n")


if __name__ == "__main__":
    sys.exit(main())
