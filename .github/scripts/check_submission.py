"""Validate the submissions that a change adds or edits: replay, re-run and fresh episodes.

::

    check_submission.py --clone DIR (--base SHA [--only-one] | --name NAME) --head SHA --output DIR

It takes ``submissions/NAME/`` from the clone and runs this environment's ``minitouch-bench
leaderboard validate`` on a copy. Written to ``--output``: ``result.json`` and ``output.txt`` for
``post_report.py``, ``proofs/NAME.json`` of each valid submission, and ``leaderboard/`` with it.
``--only-one``: exit 1 unless the change is in one submission's directory and nowhere else.
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
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[2]
COMMAND = (sys.executable, "-m", "minitouch_bench", "leaderboard")

OUTCOMES = {0: "valid", 1: "refused", 5: "not finished", 6: "not readable"}
"""What the exit codes of ``leaderboard validate`` mean where it says ``N of 1 valid``; any other
end is a fault of the program."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
MAX_OUTPUT = 20_000
"""The last bytes of the program's output that are kept: ``post_report.py`` posts so many."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Check what changed; return 0 where every submission is valid."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--clone", type=Path, required=True)
    parser.add_argument("--base")
    parser.add_argument("--name")
    parser.add_argument("--head", required=True)
    parser.add_argument("--only-one", action="store_true")
    parser.add_argument("--output", type=Path, required=True)
    given = parser.parse_args(arguments)
    given.output.mkdir(parents=True, exist_ok=True)
    names: list[str] = []
    other: list[str] = []
    if given.name is None:
        names, other = changed(given.clone, given.base, given.head)
    elif NAME.fullmatch(given.name):
        names = [given.name]
    present = [name for name in names if (given.clone / "submissions" / name).is_dir()]
    if given.only_one and (other or len(names) != 1 or not present):
        outcomes = dict.fromkeys(names, "not checked")
        named = ", ".join(map(repr, [*names, *other][:10])) or "no file of a submission"
        text = f"A submission changes submissions/NAME/ and nothing else; this changes: {named}"
        report(text, outcomes, given.head, given.output)
        return 1
    if given.name is not None and not present:
        report("There is no such submission", {}, given.head, given.output)
        return 1
    checked = {name: check(name, given.clone, given.output) for name in present}
    outcomes = {name: outcome for name, (outcome, _) in checked.items()}
    report("\n".join(text for _, text in checked.values()), outcomes, given.head, given.output)
    return 0 if all(outcome == "valid" for outcome in outcomes.values()) else 1


def changed(clone: Path, base: str, head: str) -> tuple[list[str], list[str]]:
    """Return the submissions that changed since the base, removed ones too, and other paths."""
    span = head if not base.strip("0") else f"{base}...{head}"  # a first push has no base
    listing = ["git", "-C", str(clone), "diff", "--name-only", "--no-renames", "-z", span]
    if span == head:
        listing = ["git", "-C", str(clone), "ls-tree", "-r", "--name-only", "-z", head]
    text = subprocess.run(listing, check=True, capture_output=True).stdout
    names, other = set(), []
    for path in text.decode("utf-8", "backslashreplace").split("\0"):
        parts = path.split("/")
        if len(parts) > 2 and parts[0] == "submissions" and NAME.fullmatch(parts[1]):
            names.add(parts[1])
        elif path:
            other.append(path)
    return sorted(names), other


def check(name: str, clone: Path, output: Path) -> tuple[str, str]:
    """Validate a copy of one submission beside this environment's own; keep proof and board."""
    with tempfile.TemporaryDirectory() as folder:
        submissions = Path(folder) / "submissions"
        shutil.copytree(ROOT / "submissions", submissions, symlinks=True)
        shutil.rmtree(submissions / name, ignore_errors=True)
        shutil.copytree(clone / "submissions" / name, submissions / name, symlinks=True)
        (submissions / "_proofs" / f"{name}.json").unlink(missing_ok=True)
        code, text = run((*COMMAND, "validate", "--prove", f"submissions/{name}"), folder)
        outcome = f"the check failed with exit code {code}"
        if re.search(r"\b[01] of 1 valid\b", text):
            outcome = OUTCOMES.get(code, outcome)
        proof = submissions / "_proofs" / f"{name}.json"
        if outcome == "valid" and proof.is_file():
            (output / "proofs").mkdir(exist_ok=True)
            shutil.copyfile(proof, output / "proofs" / proof.name)
        run((*COMMAND, "build", "--output", str((output / "leaderboard").absolute())), folder)
    return outcome, text


def run(command: Sequence[str], folder: str) -> tuple[int, str]:
    """Run a command; return its exit code and what it printed."""
    done = subprocess.run(
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
    )
    text = done.stdout.decode("utf-8", "backslashreplace")
    token = secrets.token_hex(16)  # until it is repeated the runner obeys no line of the text
    print(f"::stop-commands::{token}\n{text}\n::{token}::", flush=True)
    return done.returncode, text


def report(text: str, outcomes: dict[str, str], head: str, output: Path) -> None:
    """Write the files of the report, the job's summary and its outputs."""
    text = text.encode()[-MAX_OUTPUT:].decode(errors="ignore")
    (output / "result.json").write_text(json.dumps({"head": head, "outcomes": outcomes}) + "\n")
    (output / "output.txt").write_text(text, encoding="utf-8")
    if summary := os.environ.get("GITHUB_STEP_SUMMARY"):
        rows = "".join(f"| `{name}` | {outcome} |\n" for name, outcome in outcomes.items())
        indented = "\n".join(f"    {line}" for line in text.splitlines())  # a block of code
        with Path(summary).open("a", encoding="utf-8") as file:
            file.write(f"| Submission | Outcome |\n|---|---|\n{rows}\n{indented}\n")
    if outputs := os.environ.get("GITHUB_OUTPUT"):
        count = len(list((output / "proofs").glob("*.json")))
        with Path(outputs).open("a", encoding="utf-8") as file:
            file.write(f"proofs={count}\n")


if __name__ == "__main__":
    sys.exit(main())
