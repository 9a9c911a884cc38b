"""Post what the workflow "Submission" found as a comment on its pull request.

It runs with a token that may write comments, so it believes nothing of a pull request: which one it
is and what it changes comes from GitHub's interface, and of the files that the checking job left
only an outcome from a fixed list and a text, shown as code, come into the comment. A pull request
that changes more than one submission's directory could have changed the checking job itself; its
report is not posted.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

MARK = "<!-- minitouch-bench: submission report -->"
OUTCOMES = ("sound", "sound, with policy faults", "refused", "not checked")
MAX_TEXT = 20_000
MAX_LISTED = 3000
"""GitHub lists so many files of a pull request and leaves out the others without a word."""
SUBMISSION = re.compile(r"submissions/([A-Za-z0-9][A-Za-z0-9._-]{0,99})/[^\n]+")


def main() -> int:
    """Find the pull request and write its comment.

    The head is read again last: what was listed before is of this commit only if it has not moved.
    """
    found = pull_request()
    if found is None:
        print("no open pull request has this commit as its head: nothing to post")
        return 0
    number, base = found
    body = comment(number, base, Path(os.environ["CHECKED"]))
    comments = api(f"issues/{number}/comments?per_page=100", "--paginate", "--slurp")
    if pull_request() != found:
        print("the pull request has moved on: nothing to post")
        return 0
    ours = [
        one["id"]
        for page in comments
        for one in page
        if one["user"]["login"] == "github-actions[bot]" and one["body"].startswith(MARK)
    ]
    if ours:
        api(f"issues/comments/{ours[0]}", "--method", "PATCH", body={"body": body})
    else:
        api(f"issues/{number}/comments", "--method", "POST", body={"body": body})
    return 0


def api(place: str, *options: str, body: object = None) -> Any:
    """Call GitHub's interface below this repository and return its answer."""
    command = ["gh", "api", f"repos/{os.environ['GITHUB_REPOSITORY']}/{place}", *options]
    given = None if body is None else json.dumps(body)
    if given is not None:
        command += ["--input", "-"]
    done = subprocess.run(command, input=given, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def pull_request() -> tuple[int, str] | None:
    """Return number and base of the open pull request whose head the job checked."""
    owner, branch = os.environ["HEAD_OWNER"], os.environ["HEAD_BRANCH"]
    command = ["pulls", "--method", "GET", "-f", "state=open", "-f", f"head={owner}:{branch}"]
    for one in api(*command):
        if one["head"]["sha"] == os.environ["HEAD_SHA"]:
            return int(one["number"]), str(one["base"]["ref"])
    return None


def comment(number: int, base: str, checked: Path) -> str:
    """Return the text of the comment."""
    head, url = os.environ["HEAD_SHA"], os.environ["RUN_URL"]
    pages = api(f"pulls/{number}/files?per_page=100", "--paginate", "--slurp")
    files = [one for page in pages for one in page]
    paths = [
        name for one in files for name in (one["filename"], one.get("previous_filename")) if name
    ]
    names = {found[1] if (found := SUBMISSION.fullmatch(path)) else "" for path in paths}
    start = f"{MARK}\n### Check of the submission\n\n"
    end = f"\n\nCommit {head}, against `{base}`: [log]({url})."
    if len(names) != 1 or "" in names or len(files) >= MAX_LISTED:
        return (
            f"{start}This pull request changes more than one submission's directory, or "
            f"{MAX_LISTED:,} files or more. Its report is not posted: such a change could have "
            f"changed the check itself. Move everything else into another pull request.{end}"
        )
    (name,) = names
    outcome, text = findings(checked, name, head)
    added = {one["filename"] for one in files if one["status"] == "added"}
    is_new = f"submissions/{name}/submission.toml" in added
    what = "" if is_new else ", **a change of a submission that exists: is it its owner's?**"
    return (
        f"{start}`{name}`: **{outcome}**{what}\n\n{as_code(text)}\n\nIts files were checked, and "
        "the suite smoke was played in the sandbox, with the program of the target branch. No "
        "number of this enters the leaderboard: the row is played after the merge. A policy that "
        f"leaves the sandbox could forge this text; see SECURITY.md.{end}"
    )


def findings(checked: Path, name: str, head: str) -> tuple[str, str]:
    """Return outcome and output as the checking job wrote them, within what they may be."""
    try:
        result = json.loads(read(checked / "result.json"))
        outcome = result["outcomes"][name] if result["head"] == head else None
        text = read(checked / "output.txt")
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        outcome, text = None, ""
    return (outcome if outcome in OUTCOMES else "the check did not finish"), text


def read(path: Path) -> str:
    """Return the start of a plain file as text."""
    if path.is_symlink():
        raise OSError(f"{path} is a link")
    with path.open("rb") as file:
        return file.read(MAX_TEXT).decode("utf-8", "replace")


def as_code(text: str) -> str:
    """Return a text as a block of code that nothing in it can end."""
    longest = max((len(run) for run in re.findall("`+", text)), default=0)
    fence = "`" * max(3, longest + 1)
    shown = "".join(one for one in text if one.isprintable() or one == "\n").strip()
    return f"{fence}text\n{shown}\n{fence}"


if __name__ == "__main__":
    sys.exit(main())
