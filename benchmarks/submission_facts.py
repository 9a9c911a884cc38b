"""Bring runs that an older version wrote to this version's form: ``run.json`` 3, and facts alone.

``make facts`` does it once in ``submissions/`` and ``reports/baseline/``; other directories are
named on the command line. Episodes, estimates and digests stay as they are. A proof stays with
the run that it was made for: it gets the new SHA-256 of a ``run.json`` whose old one it had. A
file that nobody knows stays: ``validate`` names it.
"""

import hashlib
import json
import sys
from pathlib import Path
from typing import Any

from minitouch_bench.errors import RunDirectoryError
from minitouch_bench.files import RUN_FILE, RUN_FILES, SUBMISSION_FILE, write_file
from minitouch_bench.leaderboard.proof import proof_path, read_proof
from minitouch_bench.policies.limits import USUAL_LIMITS
from minitouch_bench.runs.run import RUN_VERSION, parse_run, run_json

PLACES = ("submissions", "reports/baseline")
FACTS = (RUN_FILE, "actions.npz")


def main() -> None:
    """Migrate every run below the directories."""
    for place in map(Path, sys.argv[1:] or PLACES):
        for file in sorted(place.rglob(RUN_FILE)):
            if migrate(file):
                print(f"{file} is version {RUN_VERSION} now")
            if (file.parents[2] / SUBMISSION_FILE).exists():
                remove_views(file.parent)


def migrate(file: Path) -> bool:
    """Write a ``run.json`` of version 2 as version 3; return whether it was one."""
    before = file.read_bytes()
    document = json.loads(before)
    if document["version"] != RUN_VERSION - 1:
        return False
    document["version"] = RUN_VERSION
    document["header"] = with_plan(document["header"])
    content = run_json(parse_run(json.dumps(document).encode(), file.parent.name))
    write_file(file, content)
    keep_proof(file, before, content)
    return True


def with_plan(header: dict[str, Any]) -> dict[str, Any]:
    """Return a header of version 3, where the plan has a record of its own."""
    limits = dict(vars(USUAL_LIMITS))
    limits |= {name: header.pop(name) for name in limits if name in header}
    plan = {name: header.pop(name) for name in ("suite", "tasks", "episodes", "seed")}
    plan |= {"chosen": header.pop("chosen_episodes", []), "limits": limits}
    if "conditions" in header:
        plan["conditions"] = header.pop("conditions")
    return {**header, "plan": plan}


def keep_proof(file: Path, before: bytes, after: bytes) -> None:
    """Bind the proof of a submission to the new bytes of a run, if it was made for the old ones."""
    submission = file.parents[2]
    path = proof_path(submission.resolve())
    try:
        proof = read_proof(path)
    except RunDirectoryError:
        return
    place = file.relative_to(submission).as_posix()
    if proof is not None and proof.files.get(place) == hashlib.sha256(before).hexdigest():
        document = json.loads(path.read_bytes())
        document["files"][place] = hashlib.sha256(after).hexdigest()
        write_file(path, json.dumps(document, indent=1) + "\n")


def remove_views(run: Path) -> None:
    """Remove the files that follow from a run's facts."""
    for name in RUN_FILES:
        if name not in FACTS and (run / name).exists():
            (run / name).unlink()
            print(f"removed {run / name}")


if __name__ == "__main__":
    main()
