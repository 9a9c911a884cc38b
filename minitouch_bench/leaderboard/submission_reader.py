"""Read ``submission.toml``: every fault is collected, none stops the reading."""

import re
import tomllib
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from minitouch_bench.errors import MiniTouchError, RunDirectoryError, UsageError
from minitouch_bench.leaderboard.faults import Faults
from minitouch_bench.leaderboard.submission import (
    ALL_TASKS,
    FORMAT,
    MAIN_SUITE,
    MODALITIES,
    SUBMISSION_FILE,
    SUBMITTED_SUITES,
    VERSION,
    About,
    CheckpointFile,
    Submission,
    TrainingSeed,
    checkpoint_place,
    run_place,
)
from minitouch_bench.leaderboard.texts import (
    check_file_name,
    check_licence,
    check_link,
    check_name,
    check_text,
)
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.records import Role
from minitouch_bench.reporting.json_reader import JsonNode

MAX_METHOD, MAX_AUTHOR, MAX_NOTES = 120, 100, 2000
MAX_AUTHORS, MAX_SEEDS = 50, 20
MAX_STEPS = 10**12
MAX_SEED = 2**63 - 1
SHA256 = re.compile(r"[0-9a-f]{64}")

TOP_KEYS = (
    "format",
    "version",
    "name",
    "method",
    "authors",
    "paper",
    "code",
    "licence",
    "training_steps",
    "modalities",
    "notes",
    "seeds",
)
SEED_KEYS = ("seed", "runs", "checkpoints")
FILE_KEYS = ("role", "task", "file", "sha256", "path")
SEE = "see docs/submitting.md"

Value = TypeVar("Value")
NO_RUNS: dict[str, str] = {}
NO_NODES: tuple[JsonNode, ...] = ()


def read_submission(content: bytes, faults: Faults) -> Submission | None:
    """Read the file's bytes; None where it is no submission at all, else what is sound in it."""
    try:
        document = tomllib.loads(content.decode())
    except (ValueError, RecursionError) as error:  # both decoding errors are ValueErrors
        faults.add(SUBMISSION_FILE, f"it is not TOML: {error}", SEE)
        return None
    node = JsonNode(document, SUBMISSION_FILE)
    try:
        _check_version(node)
    except RunDirectoryError as error:
        faults.add(SUBMISSION_FILE, str(error), SEE)
        return None
    reader = _Reader(faults)
    reader.check_keys(document, TOP_KEYS, SUBMISSION_FILE, TOP_KEYS)
    return Submission(_about(reader, node), _seeds(reader, node))


class _Reader:
    """Reads one key at a time and keeps its fault."""

    def __init__(self, faults: Faults) -> None:
        self.faults = faults

    def get(
        self, node: JsonNode, key: str, read: Callable[[JsonNode], Value], otherwise: Value
    ) -> Value:
        """Return a key's value, or ``otherwise`` where it is absent or at fault."""
        try:
            members = node.mapping()
            return read(members[key]) if key in members else otherwise
        except RunDirectoryError as error:  # carries its place
            self.faults.add(SUBMISSION_FILE, str(error).removeprefix(f"{SUBMISSION_FILE}."), SEE)
        except MiniTouchError as error:
            self.faults.add(SUBMISSION_FILE, f"{key}: {error}", SEE)
        return otherwise

    def check_keys(
        self, found: Any, known: tuple[str, ...], place: str, needed: tuple[str, ...]
    ) -> None:
        """Keep a fault for each key that is unknown or missing."""
        if not isinstance(found, Mapping):
            return
        for key in found:
            if key not in known:
                self.faults.add(place, f"it has no key '{key}'", "remove it")
        for key in needed:
            if key not in found:
                self.faults.add(place, f"'{key}' is missing", SEE)


def _check_version(node: JsonNode) -> None:
    if node["format"].text() != FORMAT:
        raise RunDirectoryError(f"its format is not '{FORMAT}'")
    if (version := node["version"].integer()) != VERSION:
        raise RunDirectoryError(f"it has version {version}, this program reads {VERSION}")


def _about(reader: _Reader, node: JsonNode) -> About:
    return About(
        name=reader.get(node, "name", _name, ""),
        method=reader.get(node, "method", lambda value: _required_text(value, MAX_METHOD), ""),
        authors=reader.get(node, "authors", _authors, ()),
        paper=reader.get(node, "paper", _link, ""),
        code=reader.get(node, "code", _link, ""),
        licence=reader.get(node, "licence", _licence, ""),
        training_steps=reader.get(node, "training_steps", lambda v: _count(v, MAX_STEPS), 0),
        modalities=reader.get(node, "modalities", _modalities, ()),
        notes=reader.get(node, "notes", lambda value: _text(value, MAX_NOTES), ""),
    )


def _seeds(reader: _Reader, node: JsonNode) -> tuple[TrainingSeed, ...]:
    entries = reader.get(node, "seeds", _nodes, NO_NODES)
    if not entries:
        reader.faults.add(SUBMISSION_FILE, "it has no training seed", "add a [[seeds]] table")
    if len(entries) > MAX_SEEDS:
        reader.faults.add(SUBMISSION_FILE, f"it has more than {MAX_SEEDS} training seeds", SEE)
    seeds = [_seed(reader, entry) for entry in entries[:MAX_SEEDS]]
    numbers = [seed.seed for seed in seeds]
    for number in sorted({number for number in numbers if numbers.count(number) > 1}):
        reader.faults.add(SUBMISSION_FILE, f"training seed {number} is there twice", "remove one")
    return tuple(seeds)


def _seed(reader: _Reader, node: JsonNode) -> TrainingSeed:
    members = _members(reader, node)
    reader.check_keys(members, SEED_KEYS, f"{SUBMISSION_FILE}, seeds", ("seed", "runs"))
    if not members:
        return TrainingSeed(-1, {})
    seed = reader.get(node, "seed", lambda value: _count(value, MAX_SEED), -1)
    runs = reader.get(node, "runs", JsonNode.text_mapping, NO_RUNS)
    _check_runs(reader, seed, runs)
    files = reader.get(node, "checkpoints", _nodes, NO_NODES)
    return TrainingSeed(
        seed,
        {suite: run_place(seed, suite) for suite in SUBMITTED_SUITES if suite in runs},
        tuple(_checkpoint(reader, seed, file) for file in files),
    )


def _members(reader: _Reader, node: JsonNode) -> dict[str, JsonNode]:
    """Return a table's members, none where it is no table."""
    try:
        return node.mapping()
    except RunDirectoryError as error:
        reader.faults.add(SUBMISSION_FILE, str(error), SEE)
        return {}


def _check_runs(reader: _Reader, seed: int, runs: Mapping[str, str]) -> None:
    """Hold the runs' places against the only ones there are: none can lead outside."""
    place = f"{SUBMISSION_FILE}, seed {seed}"
    if MAIN_SUITE not in runs:
        reader.faults.add(place, f"it has no run of {MAIN_SUITE}", f"evaluate on {MAIN_SUITE}")
    for suite, path in runs.items():
        if suite not in SUBMITTED_SUITES:
            reader.faults.add(place, f"'{suite}' is no suite of a submission", "remove it")
        elif path != run_place(seed, suite):
            reader.faults.add(
                place,
                f"the run of {suite} is at '{path}', outside its place",
                f"move it to {run_place(seed, suite)}",
            )


def _checkpoint(reader: _Reader, seed: int, node: JsonNode) -> CheckpointFile:
    members = _members(reader, node)
    place = f"{SUBMISSION_FILE}, checkpoints of seed {seed}"
    reader.check_keys(members, FILE_KEYS, place, FILE_KEYS)
    role = Role(reader.get(node, "role", lambda value: value.choice(tuple(Role)), "final"))
    file = reader.get(node, "file", _file_name, "")
    path = reader.get(node, "path", JsonNode.text, "")
    expected = checkpoint_place(seed, role, file)
    if path not in ("", expected) and file:
        reader.faults.add(
            place,
            f"{file} is at '{path}', outside its place",
            f'move it to {expected}, or write ""',
        )
        path = ""
    return CheckpointFile(
        role=role,
        task=reader.get(node, "task", lambda v: v.choice((ALL_TASKS, *TASK_NAMES)), ALL_TASKS),
        file=file,
        sha256=reader.get(node, "sha256", _sha256, ""),
        path=path,
    )


def _nodes(node: JsonNode) -> tuple[JsonNode, ...]:
    return tuple(node)


def _name(node: JsonNode) -> str:
    check_name(node.text())
    return node.text()


def _text(node: JsonNode, longest: int) -> str:
    check_text(node.text(), longest)
    return node.text()


def _required_text(node: JsonNode, longest: int) -> str:
    if not node.text():
        raise UsageError("it is empty")
    return _text(node, longest)


def _authors(node: JsonNode) -> tuple[str, ...]:
    found = node.texts()
    if len(found) > MAX_AUTHORS:
        raise UsageError(f"there are {len(found)}; the limit is {MAX_AUTHORS}")
    for author in found:
        check_text(author, MAX_AUTHOR)
    return found


def _link(node: JsonNode) -> str:
    check_link(node.text())
    return node.text()


def _licence(node: JsonNode) -> str:
    check_licence(node.text())
    return node.text()


def _file_name(node: JsonNode) -> str:
    check_file_name(node.text())
    return node.text()


def _count(node: JsonNode, largest: int) -> int:
    if node.count() > largest:
        raise UsageError(f"{node.count()} is more than {largest}")
    return node.count()


def _modalities(node: JsonNode) -> tuple[str, ...]:
    found = {value.choice(tuple(MODALITIES)) for value in node}
    return tuple(name for name in MODALITIES if name in found)


def _sha256(node: JsonNode) -> str:
    if not SHA256.fullmatch(node.text()):
        raise UsageError("it is not 64 digits of 0-9, a-f")
    return node.text()
