"""``submission.toml``: read with every problem it has, written, and its schema.

Its types are those of ``submission``. A problem never stops the reading.
"""

import tomllib
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from minitouch_bench.documents import read_table, schema_of, write_toml
from minitouch_bench.errors import UsageError
from minitouch_bench.leaderboard.submission import (
    FORMAT,
    MAIN_SUITE,
    SUBMISSION_FILE,
    SUBMITTED_SUITES,
    VERSION,
    CheckpointFile,
    Submission,
    TrainingSeed,
    checkpoint_place,
    run_place,
)
from minitouch_bench.leaderboard.submission_rules import (
    MAX_AUTHOR,
    MAX_METHOD,
    MAX_NOTES,
    check_file_name,
    check_license,
    check_link,
    check_name,
    check_text,
)
from minitouch_bench.verification.problems import Problems

SEE = "see docs/submitting.md"


def read_submission(content: bytes, problems: Problems) -> Submission | None:
    """Read the file's bytes; None where it is no submission at all, else what is sound in it."""
    try:
        document = tomllib.loads(content.decode())
    except (ValueError, RecursionError) as error:  # both decoding errors are ValueErrors
        problems.add(SUBMISSION_FILE, f"it is not TOML: {error}", SEE)
        return None
    if document.get("format") != FORMAT:
        problems.add(SUBMISSION_FILE, f"its format is not '{FORMAT}'", SEE)
        return None
    if (version := document.get("version")) != VERSION:
        problems.add(
            SUBMISSION_FILE, f"it has version {version}, this program reads {VERSION}", SEE
        )
        return None
    submission, mistakes = read_table(document, Submission)
    for mistake in mistakes:
        problems.add(SUBMISSION_FILE, mistake, SEE)
    for key, mistake in (*_texts(submission), *_seeds(submission)):
        if key in document and not any(found.startswith(key) for found in mistakes):
            problems.add(SUBMISSION_FILE, f"{key}: {mistake}", SEE)
    return replace(submission, seeds=tuple(map(_in_place, submission.seeds)))


def submission_toml(submission: Submission) -> str:
    """Write a submission as TOML; the texts must have passed ``read_submission``."""
    return write_toml(submission)


def submission_schema() -> dict[str, Any]:
    """Return the JSON schema of ``submission.toml``, as the JSON value a TOML reader gives."""
    schema = schema_of(Submission, "A submission to the MiniTouch leaderboard")
    runs = schema["$defs"]["TrainingSeed"]["properties"]["runs"]
    runs["additionalProperties"] = False
    runs["required"] = [MAIN_SUITE]
    runs["properties"] = {
        suite: {"type": "string", "pattern": f"^seed-[0-9]+/{suite}$"} for suite in SUBMITTED_SUITES
    }
    return schema


def _texts(submission: Submission) -> Iterator[tuple[str, str]]:
    """Walk through what is wrong with the texts, by key."""
    if not submission.method:
        yield "method", "it is empty"
    yield from _refused("name", check_name, submission.name)
    yield from _refused("method", check_text, submission.method, MAX_METHOD)
    for author in submission.authors:
        yield from _refused("authors", check_text, author, MAX_AUTHOR)
    yield from _refused("paper", check_link, submission.paper)
    yield from _refused("code", check_link, submission.code)
    yield from _refused("license", check_license, submission.license)
    yield from _refused("notes", check_text, submission.notes, MAX_NOTES)
    if len(set(submission.modalities)) < len(submission.modalities):
        yield "modalities", "one of them is there twice"


def _refused(
    key: str, check: Callable[..., None], text: str, *limits: int
) -> Iterator[tuple[str, str]]:
    try:
        check(text, *limits)
    except UsageError as error:
        yield key, str(error)


def _seeds(submission: Submission) -> Iterator[tuple[str, str]]:
    """Walk through what is wrong with the training seeds."""
    if not submission.seeds:
        yield "seeds", "there is no training seed; add a [[seeds]] table"
    numbers = [seed.seed for seed in submission.seeds]
    for number in sorted({number for number in numbers if numbers.count(number) > 1}):
        yield "seeds", f"training seed {number} is there twice; remove one"
    for seed in submission.seeds:
        for mistake in (*_runs(seed), *(m for file in seed.checkpoints for m in _file(seed, file))):
            yield "seeds", f"seed {seed.seed}, {mistake}"


def _runs(seed: TrainingSeed) -> Iterator[str]:
    """Hold the runs' paths against the only ones there are: none can lead outside."""
    if MAIN_SUITE not in seed.runs:
        yield f"it has no run of {MAIN_SUITE}; evaluate on {MAIN_SUITE}"
    for suite, path in seed.runs.items():
        if suite not in SUBMITTED_SUITES:
            yield f"'{suite}' is no suite of a submission; remove it"
        elif path != run_place(seed.seed, suite):
            yield (
                f"the run of {suite} is at '{path}', outside its place; "
                f"move it to {run_place(seed.seed, suite)}"
            )


def _in_place(seed: TrainingSeed) -> TrainingSeed:
    """Return a training seed with the only paths there are, whatever it says."""
    places = {suite: run_place(seed.seed, suite) for suite in SUBMITTED_SUITES}
    files = (
        replace(file, path=file.path and checkpoint_place(seed.seed, file.role, file.file))
        for file in seed.checkpoints
        if not list(_file(seed, replace(file, path="")))
    )
    runs = {suite: place for suite, place in places.items() if suite in seed.runs}
    return replace(seed, runs=runs, checkpoints=tuple(files))


def _file(seed: TrainingSeed, file: CheckpointFile) -> Iterator[str]:
    try:
        check_file_name(file.file)
    except UsageError as error:
        yield f"file: {error}"
        return
    expected = checkpoint_place(seed.seed, file.role, file.file)
    if file.path not in ("", expected):
        what = f"{file.file} is at '{file.path}', outside its place"
        yield f"{what}; move it to {expected}, or write no path"
