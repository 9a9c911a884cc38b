"""Runs and submissions spoiled at random, each read within limits.

``python -m tests.verification.mutations KIND SEED COUNT`` prints what was found, as JSON. It is a
process of its own, because a limit of memory cannot be taken back.
"""

import contextlib
import io
import json
import os
import pickle
import random
import resource
import shutil
import signal
import sys
import traceback
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import typer

from minitouch_bench.commands.report import report
from minitouch_bench.comparison.comparison import compare_runs
from minitouch_bench.episode import PlayedEpisode, Role
from minitouch_bench.errors import MiniTouchError
from minitouch_bench.evaluation.execution import header_of, open_run
from minitouch_bench.evaluation.policy_setup import PolicySetup
from minitouch_bench.files import (
    ACTIONS_FILE,
    GIB,
    JOURNAL_FILE,
    MIB,
    RUN_FILE,
    lock_directory,
)
from minitouch_bench.leaderboard.site import build_board
from minitouch_bench.leaderboard.submission import check_submission
from minitouch_bench.policies.sources import parse_source
from minitouch_bench.reporting.report import write_views
from minitouch_bench.runs.actions import write_actions
from minitouch_bench.runs.journal import Journal
from minitouch_bench.runs.plan import Plan
from minitouch_bench.runs.run import read_run
from tests.leaderboard.synthetic import make_submission
from tests.reporting.synthetic import played, write
from tests.verification.conftest import verify_run

TIME_LIMIT_S = 120
MEMORY_LIMIT = GIB
SECRET = "words of the user that nobody else may see"
REQUEST = PolicySetup(Plan("table4", ("pushing", "opening"), 2, 0), parse_source("random"))


class TooLongError(BaseException):
    """A reader took longer than its limit."""


class Replayed:
    """An engine that knows the episodes already: no simulator is needed to read the rest."""

    def __init__(self, records: tuple[PlayedEpisode, ...]) -> None:
        self._records = {record.spec: record for record in records}

    def run(self, source, specs):
        for spec in specs:
            if spec not in self._records:
                raise MiniTouchError(f"{spec.key} cannot be replayed here")
            yield self._records[spec]


def sound_run(directory: Path) -> tuple[PlayedEpisode, ...]:
    """Write a small run with all its files, also those of one that is not finished."""
    made = played(REQUEST.plan, {Role.FINAL: REQUEST.policy.identity()}, 0.7, 1)
    directory.mkdir()
    journal = Journal.begin(made.header, {}, directory)
    for record in made.records:
        journal.keep(record)
    write_actions(made.records, directory)
    run = write(made, directory)
    (directory / "videos").mkdir()
    (directory / "videos" / "pushing-0.mp4").write_bytes(b"video")
    write_views(run, directory)
    return made.records


# What is done to a file


def flip(file: Path, chance: random.Random, mine: Path) -> None:
    content = bytearray(file.read_bytes() or b"x")
    for _ in range(chance.choice([1, 1, 5, 50])):
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    file.write_bytes(content)


def truncate(file: Path, chance: random.Random, mine: Path) -> None:
    os.truncate(file, chance.choice([chance.randrange(file.stat().st_size + 1), 2**31, 2**40]))


def debris(file: Path, chance: random.Random, mine: Path) -> None:
    content = chance.randbytes(chance.randrange(1000))
    file.write_bytes(chance.choice([content, file.read_bytes() + content, b"", b"\x00" * 5000]))


def remove(file: Path, chance: random.Random, mine: Path) -> None:
    file.unlink()


def link(file: Path, chance: random.Random, mine: Path) -> None:
    targets = [mine / "secret.txt", mine, mine / "new.txt", file, Path("/dev/zero"), mine / "pipe"]
    file.unlink()
    file.symlink_to(chance.choice(targets))


def folder_link(file: Path, chance: random.Random, mine: Path) -> None:
    folder = file.parent
    if folder.name in ("run", "hac"):
        names = ["videos", "tensorboard", "replays", "checkpoints", "seed-0"]
        folder /= chance.choice(names)
    if not folder.is_symlink():
        shutil.rmtree(folder, ignore_errors=True)
        folder.symlink_to(mine)


def special(file: Path, chance: random.Random, mine: Path) -> None:
    """Put a pipe or a directory in the place of a file, or of one that may come."""
    file = chance.choice([file, file, file.with_name(".lock"), file.with_name(JOURNAL_FILE)])
    file.unlink(missing_ok=True)
    if chance.random() < 0.5:
        os.mkfifo(file)
    else:
        (file / "inner").mkdir(parents=True)


def other_value(chance: random.Random, mine: Path) -> object:
    deep: object = []
    for _ in range(500):
        deep = [deep]
    values = [
        None, True, -1, 0, 2**63, 10**30, 1e308, 5e-324, float("nan"), "", "x" * 100_000,
        "\x1b[31m\u202e", str(mine / "secret.txt"), "../../mine", "a" * 64, [], {"": {}}, deep,
        [0] * 1000, "pushing", "success", "\ud800",
    ]  # fmt: skip
    return chance.choice(values)


def change_value(document: object, chance: random.Random, mine: Path) -> object:
    """Put another value at one place in a JSON document, or add or remove a key."""
    if not isinstance(document, dict | list) or not document or chance.random() < 0.15:
        return other_value(chance, mine)
    if isinstance(document, list):
        index = chance.randrange(len(document))
        if chance.random() < 0.1:
            return document * 2 if len(document) < 500 else document[:index]
        document[index] = change_value(document[index], chance, mine)
    else:
        key = chance.choice(list(document))
        if chance.random() < 0.1:
            document[chance.choice(["", "\x1b[0m", "extra", key])] = other_value(chance, mine)
        document[key] = change_value(document[key], chance, mine)
    return document


def other_type(file: Path, chance: random.Random, mine: Path) -> None:
    """Change a value of a file by the file's own rules, so that only the value is wrong."""
    if file.suffix == ".json":
        document = json.loads(file.read_text())
        for _ in range(chance.choice([1, 1, 3])):
            document = change_value(document, chance, mine)
        file.write_text(json.dumps(document, indent=1) + "\n")
    elif file.name == ACTIONS_FILE:
        with np.load(file) as archive:
            arrays = dict(archive)
        key = chance.choice(list(arrays))
        arrays[key] = chance.choice([
            np.zeros((200, 4)), np.zeros(30_000_000, np.float32), np.full((5, 4), np.nan, "<f4"),
            np.zeros((0, 4), "<f4"), np.array(5.0), np.zeros((5, 4), ">f4"),
        ])  # fmt: skip
        np.savez_compressed(file, **arrays)
        if chance.random() < 0.3:
            with zipfile.ZipFile(file, "a") as archive:
                archive.writestr(key + ".npy", pickle.dumps(print))
    else:
        text = file.read_text(errors="replace").replace("0", str(other_value(chance, mine))[:99], 2)
        file.write_text(text, errors="replace")


MUTATIONS: tuple[Callable[[Path, random.Random, Path], None], ...] = (
    flip, truncate, debris, remove, link, folder_link, special,
    other_type, other_type, other_type, other_type,
)  # fmt: skip


def mutate(directory: Path, chance: random.Random, mine: Path) -> str:
    """Spoil one or two files of a directory; return what was done."""
    done = []
    for _ in range(chance.choice([1, 1, 1, 2])):
        files = sorted(
            path for path in directory.rglob("*") if path.is_file() and not path.is_symlink()
        )
        small = [path for path in files if path.stat().st_size < GIB]
        if not small:
            break
        file = chance.choice(small)
        mutation = chance.choice(MUTATIONS)
        with contextlib.suppress(Exception):  # spoiled before
            mutation(file, chance, mine)
            done.append(f"{mutation.__name__} {file.relative_to(directory)}")
    return ", ".join(done)


# Who reads it


def readers_of_a_run(
    directory: Path, sound: Path, engine: Replayed
) -> Iterator[tuple[str, Callable[[], object]]]:
    def resume() -> None:
        with lock_directory(directory):
            with contextlib.suppress(IsADirectoryError):
                (directory / RUN_FILE).unlink(missing_ok=True)
            open_run(header_of(REQUEST), directory, resume=True, fresh=False)

    yield "verify", lambda: verify_run(read_run(directory), engine)
    yield "compare", lambda: compare_runs([read_run(sound), read_run(directory)], ["a", "b"])
    yield "report", lambda: report([directory])
    yield "resume", resume


def readers_of_a_submission(
    directory: Path, sound: Path, engine: Replayed
) -> Iterator[tuple[str, Callable[[], object]]]:
    arena = directory.parents[1]
    yield "check", lambda: [*check_submission(directory)]
    yield "build", lambda: build_board(directory.parent, arena / "board", arena / "results")


def within_limits(read: Callable[[], object], memory: int) -> str:
    """Call a reader; return what is wrong with it, "" if nothing."""

    def too_long(*_: object) -> None:
        raise TooLongError

    signal.signal(signal.SIGALRM, too_long)
    signal.alarm(TIME_LIMIT_S)
    resource.setrlimit(resource.RLIMIT_AS, (memory, resource.RLIM_INFINITY))
    what = ""
    try:
        with contextlib.redirect_stdout(io.StringIO()) as out:
            read()
        if SECRET in out.getvalue():
            what = "it shows what is in a file of the user"
    except (MiniTouchError, typer.Exit) as error:
        if SECRET in str(error):
            what = "its error shows what is in a file of the user"
    except TooLongError:
        what = "it hangs\n" + traceback.format_exc(limit=-6)
    except BaseException:
        what = traceback.format_exc(limit=-6)
    finally:
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    return what


def state_of(folder: Path) -> list[tuple[str, int, bytes]]:
    """Return the names, times and contents of all that lies in a folder."""
    return sorted(
        (path.name, path.lstat().st_mtime_ns, path.read_bytes() if path.is_file() else b"")
        for path in folder.rglob("*")
    )


def secret_shown(root: Path) -> bool:
    """Tell whether a file that was written holds the user's words."""
    return any(
        SECRET.encode() in path.read_bytes()
        for path in root.rglob("*")
        if path.is_file() and not path.is_symlink() and path.stat().st_size < 64 * MIB
    )


def try_mutations(kind: str, seed: int, count: int) -> list[str]:
    """Spoil one of a kind ``count`` times and have all readers read each; return the problems."""
    problems: list[str] = []
    spoiled = 0
    with TemporaryDirectory() as folder:
        root = Path(folder)
        if kind == "submission":
            sound, engine, readers = make_submission(root), Replayed(()), readers_of_a_submission
        else:
            sound = root / "run"
            engine, readers = Replayed(sound_run(sound)), readers_of_a_run
        mine = root / "mine"
        mine.mkdir()
        (mine / "secret.txt").write_text(SECRET)
        (mine / "pushing-0.mp4").write_text(SECRET)
        os.mkfifo(mine / "pipe")
        before = state_of(mine)
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        memory = pages * resource.getpagesize() + MEMORY_LIMIT
        for number in range(seed, seed + count):
            place = root / "arena" / "in" / sound.name
            shutil.copytree(sound, place)
            done = mutate(place, random.Random(number), mine)
            spoiled += bool(done)
            for name, read in readers(place, sound, engine):
                if what := within_limits(read, memory):
                    problems.append(f"{number} {name} ({done}): {what}")
            if state_of(mine) != before:
                problems.append(f"{number} ({done}): a file of the user was touched")
                break
            if secret_shown(root / "arena"):
                problems.append(f"{number} ({done}): a file of the user was copied")
            shutil.rmtree(root / "arena")
    if not problems and spoiled < 0.9 * count:
        problems.append(f"only {spoiled} of {count} were spoiled")
    return problems


if __name__ == "__main__":
    print(json.dumps(try_mutations(sys.argv[1], int(sys.argv[2]), int(sys.argv[3])), indent=1))
