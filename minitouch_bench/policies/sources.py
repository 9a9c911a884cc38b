"""What the user named as POLICY: a built-in, a file here or on the Hub, a server and so on.

What a file says that it unpacks to is looked at before anything is unpacked. A declaration can
lie; the sandbox's limit of memory holds those that do.
"""

import hashlib
import io
import os
import re
import urllib.parse
import zipfile
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from minitouch_bench import files
from minitouch_bench.episode import Role, Sha256
from minitouch_bench.errors import (
    CheckpointChangedError,
    InfrastructureError,
    PolicyLoadError,
    UsageError,
)
from minitouch_bench.json_io import read_toml, take_table, whole
from minitouch_bench.machine import require
from minitouch_bench.policies import lerobot
from minitouch_bench.policies.formats import BUILT_IN, FORMATS, KIND_BY_SUFFIX
from minitouch_bench.policies.policy import DIRECTORY, PolicySource
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.text import describe

TRAINED_FILE, EXPLORED_FILE = "final.safetensors", "exploration.safetensors"
KEPT_FILE = "final_{}_steps.safetensors"
"""The last policy of a training that was made longer afterwards, by its control steps."""
CONFIG_FILE = "config.toml"
"""The settings of a training, in its directory."""
TRAINED = {Role.FINAL: TRAINED_FILE, Role.EXPLORATION: EXPLORED_FILE}
"""What ``train`` leaves in its directory, which can be given in place of either."""

FACTORY_PATTERN = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")

MAX_RATIO = 100
"""Weights hardly shrink, and torch stores them unpacked."""

MAX_MEMBERS = 10_000

SERVERS = ("http://", "https://")
HUB = "hf://"
HUB_ADDRESS = re.compile(r"hf://([\w.-]+/[\w.-]+)(?:@(refs/pr/\d+|[^/@]+))?/([^@]+)")
COMMIT = re.compile("[0-9a-f]{40}")

ALL_TASKS = "all"
"""The task of a checkpoint that serves every task."""

FILE_NAME = Meta(
    pattern=whole(r"(?!.*\.\.)[A-Za-z0-9][A-Za-z0-9._-]{0,126}[A-Za-z0-9]"),
    description="A file name of letters, digits, '.', '_', '-', that begins and ends with a "
    "letter or digit, without '..'.",
)
ADDRESS = Meta(
    pattern=whole(r"(?:hf://[\w-][\w.-]*/[\w-][\w.-]*@[0-9a-f]{40}(?:/[\w-][\w.-]*)+)?"),
    description="A file on the Hub at a full commit, hf://USER/REPO@COMMIT/FILE, or nothing.",
)


@dataclass(frozen=True)
class CheckpointFile:
    """One file of a submitted policy.

    ``task``: a task, or "all" where one file serves every task. ``address``: where it is fetched
    from on the Hub, "" for a file of the submission.
    """

    role: Role
    task: Annotated[str, Meta(pattern=whole("|".join((ALL_TASKS, *TASK_NAMES))))]
    file: Annotated[str, FILE_NAME]
    sha256: Sha256
    address: Annotated[str, ADDRESS] = ""


@dataclass(frozen=True)
class SubmittedTraining:
    """One training of a submitted method: its seed, and the checkpoints of its policies."""

    seed: Annotated[int, Meta(ge=0, le=2**63 - 1)]
    checkpoints: tuple[CheckpointFile, ...] = ()

    @property
    def folder(self) -> str:
        """What the training is called in its submission."""
        return f"seed-{self.seed}"

    def files(self, role: Role) -> tuple[CheckpointFile, ...]:
        """Return the files of one role."""
        return tuple(file for file in self.checkpoints if file.role is role)

    def place(self, file: CheckpointFile) -> str:
        """Return where a file lies in the submission: the only place that there is for it."""
        return f"{files.CHECKPOINTS}/{self.folder}/{file.role}/{file.file}"

    def digest(self, role: Role) -> str:
        """Return the digest of a role's policy as runs record it, "" where there is none."""
        listed = self.files(role)
        if [file.task for file in listed] == [ALL_TASKS]:
            return listed[0].sha256
        return directory_digest((file.file, file.sha256) for file in listed) if listed else ""


@dataclass(frozen=True)
class Submitted:
    """What is read of a submission to find its policies."""

    trainings: tuple[SubmittedTraining, ...]


def is_remote(text: str) -> bool:
    """Tell whether POLICY is a server's address or a file on the Hub."""
    return text.startswith((*SERVERS, HUB))


def parse_source(text: str, *, role: Role = Role.FINAL) -> PolicySource:
    """Find out what POLICY means; the tasks that a directory lacks are found when they are tried.

    Raises:
        PolicyLoadError: there is no such policy.
    """
    try:
        text.encode()
    except UnicodeEncodeError as error:
        raise PolicyLoadError(f"the name of a policy is UTF-8, not {text!a}") from error
    if text in BUILT_IN:
        return PolicySource(text, text, text)
    if is_remote(text):
        return _parse_hub(text) if text.startswith(HUB) else _parse_url(text)
    path = Path(os.path.expanduser(text))
    with files.os_errors_as(PolicyLoadError, path, "read"):
        exists, is_directory = path.exists(), path.is_dir()
    if is_directory:
        return _parse_directory(path, role)
    if not exists and (path.parent / files.SUBMISSION_FILE).is_file():
        return _parse_submission(path.parent, role, path.name)
    if exists or path.suffix in KIND_BY_SUFFIX:
        return _parse_file(path)
    if FACTORY_PATTERN.fullmatch(text):
        return PolicySource("factory", text, text)
    raise PolicyLoadError(
        f"there is no policy '{text}'.\nGive {', '.join(BUILT_IN)}, a file "
        f"({', '.join(KIND_BY_SUFFIX)}), a directory, package.module:attribute, http://... or hf://..."
    )


def trained_task(source: PolicySource) -> str | None:
    """Return the task of the training whose final policy this is, None of another policy."""
    file = Path(source.target)
    with suppress(UsageError):
        if file.name == TRAINED_FILE:
            task = read_toml(file.with_name(CONFIG_FILE)).get("task")
            return task if task in TASK_NAMES else None
    return None


def read_checkpoint(path: Path, *, follow: bool = True) -> bytes:
    """Return a checkpoint's bytes, those of a directory in one file; ``follow`` allows a link.

    Raises:
        PolicyLoadError: missing, no plain file, empty, too large or not readable.
    """
    with files.os_errors_as(PolicyLoadError, path, "read"):
        if not path.exists():
            raise PolicyLoadError(f"the policy file {path} does not exist")
        if path.is_dir():
            return lerobot.pack(path, follow=follow)
        content = files.read_file(path, files.LARGEST_CHECKPOINT, follow=follow)
    if not content:
        raise PolicyLoadError(f"the policy file {path} is empty")
    return content


def read_again(target: str, digest: str) -> bytes:
    """Return the bytes of a checkpoint that an evaluation began with.

    Raises:
        CheckpointChangedError: they are others now, or cannot be read.
    """
    try:
        content = read_checkpoint(Path(target))
    except PolicyLoadError as error:
        raise CheckpointChangedError(str(error)) from error
    if hashlib.sha256(content).hexdigest() != digest:
        raise CheckpointChangedError(f"{target} was changed since this evaluation began")
    return content


def _kind_of(path: Path) -> str:
    kind = KIND_BY_SUFFIX.get(lerobot.SUFFIX if path.is_dir() else path.suffix)
    if kind is None:
        raise PolicyLoadError(
            f"{path} has no known policy format; known are {', '.join(KIND_BY_SUFFIX)}, and "
            "package.module:attribute for Python code"
        )
    return kind


def _parse_file(path: Path, *, follow: bool = True) -> PolicySource:
    """Find out what a file is; one that the user did not name may be no link to another file."""
    kind = _kind_of(path)
    content = read_checkpoint(path, follow=follow)
    if FORMATS[kind].runs_code:
        check_zip(content, str(path))
    return PolicySource(kind, path.stem, str(path), hashlib.sha256(content).hexdigest())


def _parse_url(text: str) -> PolicySource:
    try:
        parts = urllib.parse.urlsplit(text)
    except ValueError:  # as of "http://[::1"
        parts = urllib.parse.urlsplit("")
    if not parts.hostname or parts.username or parts.query or parts.fragment:
        raise PolicyLoadError(f"'{text}' is not a server's address; write http://HOST:PORT")
    return PolicySource("remote", parts.netloc, text)


def _parse_hub(text: str) -> PolicySource:
    """Fetch a file from the Hub; its address names the commit."""
    asked = parse_hub_address(text)
    _kind_of(Path(asked.file))
    path, resolved = fetch_hub_file(asked)
    return replace(_parse_file(path), address=str(resolved))


def directory_digest(listed: Iterable[tuple[str, str]]) -> str:
    """Return the digest of a directory of policies; ``listed``: each file's name and SHA-256."""
    lines = [f"{name} {digest}\n" for name, digest in sorted(listed)]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _parse_submission(path: Path, role: Role, folder: str = "") -> PolicySource:
    """Find the policy of a training of a submission; of its first one without ``folder``."""
    try:
        table = read_toml(path / files.SUBMISSION_FILE)
        submitted = take_table({"trainings": table.get("trainings", [])}, Submitted, str(path))
    except UsageError as error:
        raise PolicyLoadError(str(error)) from error
    trainings = {training.folder: training for training in submitted.trainings}
    if not trainings:
        raise PolicyLoadError(f"{path} has no training")
    training = trainings.get(folder or next(iter(trainings)))
    if training is None:
        raise PolicyLoadError(f"{path} has no training {folder}; it has {', '.join(trainings)}")
    listed = training.files(role)
    if not listed:
        raise PolicyLoadError(f"{path / training.folder} has no {role} checkpoints")
    of_role = path / files.CHECKPOINTS / training.folder / role
    for part in (of_role, *of_role.parents[:2]):
        if part.is_symlink():
            raise PolicyLoadError(f"{part} cannot be read: it is a symbolic link")
    parts = {}
    for file in listed:
        if file.address:
            found = _parse_hub(file.address)
        else:
            found = _parse_file(path / training.place(file), follow=False)
        if found.digest != file.sha256:
            raise PolicyLoadError(f"{file.file}: its SHA-256 is not that of submission.toml")
        parts[file.task] = found
    name = path.resolve().name + (f"-{folder}" if folder else "")
    if ALL_TASKS in parts:
        return replace(parts[ALL_TASKS], name=name)
    target, digest = str(path / training.folder), training.digest(role)
    return PolicySource(DIRECTORY, name, target, digest, tuple(parts.items()))


def _parse_directory(path: Path, role: Role) -> PolicySource:
    parts: dict[str, PolicySource] = {}
    with files.os_errors_as(PolicyLoadError, path, "read"):
        if (path / files.SUBMISSION_FILE).is_file():
            return _parse_submission(path, role)
        if of_lerobot := lerobot.find_checkpoint(path):
            return replace(_parse_file(of_lerobot), name=lerobot.name_of(of_lerobot))
        found = sorted(path.iterdir())
    for file in found:
        if file.stem not in TASK_NAMES or not (
            file.suffix in KIND_BY_SUFFIX or lerobot.find_checkpoint(file) == file
        ):
            continue
        if file.stem in parts:
            other = Path(parts[file.stem].target).name
            raise PolicyLoadError(f"{path} has two policies for one task: {other}, {file.name}")
        parts[file.stem] = _parse_file(file, follow=False)
    if not parts:
        return _parse_training(path, role, found)
    digest = directory_digest((Path(part.target).name, part.digest) for part in parts.values())
    return PolicySource(DIRECTORY, path.resolve().name, str(path), digest, tuple(parts.items()))


def _parse_training(path: Path, role: Role, found: list[Path]) -> PolicySource:
    """Find the policy of a directory of ``train``, which contains ``found``."""
    trained = path / TRAINED[role]
    if trained in found:
        return replace(_parse_file(trained, follow=False), name=path.resolve().name)
    if path / TRAINED_FILE in found:
        text = f"{path} has no {trained.name}: nothing was explored there"
    elif path / CONFIG_FILE in found:
        text = (
            f"{path} is an unfinished training: finish it with train --resume, or name a file in it"
        )
    else:
        text = (
            f"{path} has no policies in it; give the directory of one training, or name one file a "
            f"task, as in {TASK_NAMES[1]}.onnx"
        )
    raise PolicyLoadError(text)


def check_zip(content: bytes, target: str) -> None:
    """Refuse a zip that unpacks to far more than it holds; leave damaged ones to their reader.

    Raises:
        PolicyLoadError: saying by how much.
    """
    # Half a kilobyte of memory for each entry, before the first can be looked at.
    if (entries := content.count(files.ENTRY_MARK)) > MAX_MEMBERS:
        raise PolicyLoadError(f"{target} contains {entries} files; the limit is {MAX_MEMBERS}")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
    except (zipfile.BadZipFile, ValueError, NotImplementedError):
        return
    declared = sum(member.file_size for member in members)
    if declares_too_much(declared, len(content)):
        raise PolicyLoadError(
            f"{target} has {len(content)} bytes and declares {declared}: it is not unpacked"
        )


def declares_too_much(declared: int, held: int) -> bool:
    """Tell whether a file of ``held`` bytes says that it unpacks to too many."""
    return declared > min(files.LARGEST_CHECKPOINT, MAX_RATIO * held)


@dataclass(frozen=True)
class HubFile:
    """A file of a repository, at a revision."""

    repository: str
    file: str
    revision: str

    def __str__(self) -> str:
        return f"{HUB}{self.repository}@{self.revision}/{self.file}"


def parse_hub_address(text: str) -> HubFile:
    """Read an address; the revision is ``main`` by default.

    Raises:
        PolicyLoadError: it is no such address.
    """
    match = HUB_ADDRESS.fullmatch(text)
    parts = f"{match[1]}/{match[3]}".split("/") if match else [""]
    if match is None or {"", ".", ".."} & {*parts}:
        raise PolicyLoadError(
            f"'{text}' is not a file on the Hub; write hf://USER/REPO@REVISION/FILE"
        )
    return HubFile(match[1], match[3], match[2] or "main")


def fetch_hub_file(asked: HubFile) -> tuple[Path, HubFile]:
    """Return the file in the library's cache, and its address with the commit.

    Raises:
        PolicyLoadError: there is no such file, or it is too large.
        InfrastructureError: the Hub cannot be reached.
        MissingExtraError: the library is not installed.
    """
    library = require("huggingface_hub", "hub")
    try:
        kept = library.try_to_load_from_cache(asked.repository, asked.file, revision=asked.revision)
        if COMMIT.fullmatch(asked.revision) and isinstance(kept, str):
            return Path(kept), asked
        url = library.hf_hub_url(asked.repository, asked.file, revision=asked.revision)
        remote = library.get_hf_file_metadata(url)
        if (remote.size or 0) > files.LARGEST_CHECKPOINT:
            raise PolicyLoadError(f"{asked} has {remote.size} bytes, which is too large")
        found = replace(asked, revision=remote.commit_hash)
        path = library.hf_hub_download(found.repository, found.file, revision=found.revision)
    except PolicyLoadError:
        raise
    except Exception as error:  # of the library, of its HTTP client, of the system
        status = getattr(getattr(error, "response", None), "status_code", None)
        is_refused = isinstance(error, ValueError) or (status is not None and status < 500)
        kind = PolicyLoadError if is_refused else InfrastructureError
        raise kind(f"{asked} cannot be fetched: {describe(error)}") from error
    return Path(path), found
