"""Policy files on the Hugging Face Hub: ``hf://USER/REPO/FILE[@REVISION]``.

A revision is a branch, a tag or a commit. It is resolved to its commit, which the address of the
file then names, so that a run says which file it was.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.files import GIB
from minitouch_bench.optional import require
from minitouch_bench.policies.wire import describe

SCHEME = "hf://"
ADDRESS = re.compile(r"hf://([\w.-]+/[\w.-]+)/([^@]+)(?:@(.+))?")
COMMIT = re.compile("[0-9a-f]{40}")
MAX_FILE_BYTES = GIB


@dataclass(frozen=True)
class HubFile:
    """A file of a repository, at a revision."""

    repository: str
    file: str
    revision: str

    def __str__(self) -> str:
        return f"{SCHEME}{self.repository}/{self.file}@{self.revision}"


def parse_address(text: str) -> HubFile:
    """Read an address; without a revision it is that of ``main``.

    Raises:
        PolicyLoadError: it is no such address.
    """
    match = ADDRESS.fullmatch(text)
    if match is None:
        raise PolicyLoadError(f"'{text}' is no file on the Hub; write hf://USER/REPO/FILE@REVISION")
    return HubFile(match[1], match[2], match[3] or "main")


def fetch(asked: HubFile) -> tuple[Path, HubFile]:
    """Return the file, in the library's cache, and its address with the commit.

    Raises:
        PolicyLoadError: there is no such file, it is too large, or the Hub cannot be reached.
        MissingExtraError: the library is not installed.
    """
    library = require("huggingface_hub", "hub")
    try:
        if not COMMIT.fullmatch(asked.revision):
            url = library.hf_hub_url(asked.repository, asked.file, revision=asked.revision)
            found = library.get_hf_file_metadata(url)
            if (found.size or 0) > MAX_FILE_BYTES:
                raise PolicyLoadError(f"{asked} has {found.size} bytes, which is too large")
            asked = HubFile(asked.repository, asked.file, found.commit_hash)
        path = library.hf_hub_download(asked.repository, asked.file, revision=asked.revision)
    except PolicyLoadError:
        raise
    except Exception as error:  # of the library, of its HTTP client, of the system
        raise PolicyLoadError(f"{asked} cannot be fetched: {describe(error)}") from error
    return Path(path), asked
