"""The sandbox as a whole: prepared once in a host, entered by each process that the host forks.

A confined policy may read the files and the variables that Python and packages need.
"""

import importlib.util
import os
import platform
import site
import socket
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from minitouch_bench.errors import IsolationError
from minitouch_bench.files import RUN_ENTRIES
from minitouch_bench.policies import kernel
from minitouch_bench.policies.kernel import NEITHER_READ_NOR_WRITE
from minitouch_bench.processes import ARITHMETIC, die_with

READABLE = (
    "/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib", "/usr/local/lib64",
    "/etc/ld.so.cache", "/etc/localtime", "/usr/share/zoneinfo", "/usr/share/locale",
    "/proc/cpuinfo", "/sys/devices/system/cpu", "/sys/devices/system/node/online",
    "/dev/zero", "/dev/urandom", "/dev/random",
)  # fmt: skip
"""The kernels of torch and onnxruntime choose themselves by what is said of the processor.

How much memory the system uses is left out: a policy can change that for later policies.
"""

PACKAGE_FOLDERS = ("site-packages", "dist-packages")
"""Names of folders that hold installed packages and nothing else."""

WRITABLE = ("/dev/null",)

HOST_SETTINGS = {**ARITHMETIC, "ORT_DISABLE_TELEMETRY": "1", "PYTHONHASHSEED": "0"}
"""Set in a host: no thread may exist before it forks, and no set may iterate by chance.

From 1.29 on, onnxruntime's Linux packages start a thread that reports models to Microsoft.
"""

KEPT_VARIABLES = frozenset({*HOST_SETTINGS, "LANG", "LC_ALL", "LC_CTYPE", "TZ"})
"""What a policy's process keeps of its environment."""

HOST_VARIABLES = KEPT_VARIABLES | {
    "PATH", "HOME", "LD_LIBRARY_PATH", "PYTHONPATH", "PYTHONHOME", "PYTHONPLATLIBDIR",
    "PYTHONUSERBASE", "PYTHONWARNINGS", "VIRTUAL_ENV", "TMPDIR",
}  # fmt: skip
"""What the process it is forked from needs beside them, to start Python and import packages.

Keys and tokens of the user must not even be in its memory, which a policy inherits.
"""


def readable_paths() -> tuple[str, ...]:
    """Return the files and folders that every policy may read."""
    schemes = ("stdlib", "platstdlib", "purelib", "platlib")
    packages = [*(sysconfig.get_path(name) for name in schemes), *site.getsitepackages()]
    if site.ENABLE_USER_SITE:
        packages.append(site.getusersitepackages())
    # Another environment's packages, joined by a .pth file or PYTHONPATH.
    packages += [path for path in sys.path if Path(path).name in PACKAGE_FOLDERS]
    package = str(Path(__file__).parents[1])
    library = os.path.join(sys.base_prefix, "lib")  # with libpython, and conda's libraries
    return tuple(dict.fromkeys((*READABLE, library, *packages, package)))


def factory_paths(target: str, private: str = "") -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return what ``package.module:attribute`` may read beside: its code and its data.

    That is what lies in the working directory, in every folder of ``sys.path``, and where its
    package lies if an editable installation put it elsewhere. Hidden entries are left out, and
    the run's directory ``private``. What is made later cannot be read.

    Returns:
        What it may read, and the folders whose entries' names it may list.

    Raises:
        IsolationError: one of these folders is the root folder or /etc.
    """
    folders = [os.getcwd(), *(path for path in sys.path if path)]
    try:
        spec = importlib.util.find_spec(target.partition(":")[0].partition(".")[0])
    except (ImportError, ValueError):
        spec = None
    if spec is not None:
        folders += spec.submodule_search_locations or [spec.origin or os.getcwd()]
    known = [Path(path).resolve() for path in readable_paths()]
    others = [
        path
        for path in dict.fromkeys(Path(folder).resolve() for folder in folders)
        if not any(path.is_relative_to(folder) for folder in known)
    ]
    for path in others:
        if Path("/etc").is_relative_to(path):
            raise IsolationError(
                f"a factory could read what lies in {path}, which is the working directory or on "
                "PYTHONPATH.\nRun the command in another directory"
            )
    run = Path(private).resolve() if private else None
    readable = [str(part) for path in others for part in _parts(path, run)]
    return tuple(readable), tuple(str(path) for path in others if path.is_dir())


def _parts(path: Path, run: Path | None) -> Iterator[Path]:
    """Yield what may be read of a folder, or the path itself if it is none.

    A rule of Landlock holds for all that is below, so that a folder around what is left out
    cannot be named itself. A link opens nothing: what it points to is named or not.
    """
    if not path.is_dir():
        yield path
        return
    with suppress(PermissionError):
        for entry in sorted(path.iterdir()):
            is_of_run = entry == run or (path == run and entry.name in RUN_ENTRIES)
            if is_of_run or entry.name.startswith(".") or entry.is_symlink():
                continue
            if run is not None and run.is_relative_to(entry):
                yield from _parts(entry, run)
            else:
                yield entry


PRICE = (
    "With --isolation process a policy could read and write your files, use the network and "
    "signal your programs: only for files you trust"
)
ENTERED, REFUSED, FIRST_ESCAPE = 100, 101, 10
"""Exit codes of a process that tried the sandbox: it holds; it could not be entered; by what deed
it was left."""


@dataclass(frozen=True)
class Sandbox:
    """What a process needs to confine itself; ``ruleset`` is a descriptor of Landlock's."""

    abi: int
    ruleset: int
    memory_bytes: int
    cpu_s: int
    threads: bool

    def enter(self, kept: tuple[int, ...]) -> None:
        """Confine this single-threaded process for good; the descriptors ``kept`` stay open.

        Raises:
            OSError: the kernel refused a part of it; the process must end then.
        """
        kernel.set_limits(self.memory_bytes, self.cpu_s)
        for name in set(os.environ) - KEPT_VARIABLES:  # but what numbers depend on
            del os.environ[name]
        kernel.close_others((*kept, self.ruleset))
        kernel.prctl(kernel.PR_SET_NO_NEW_PRIVS, 1)
        kernel.drop_capabilities()
        kernel.restrict_self(self.ruleset, self.abi)
        os.close(self.ruleset)
        kernel.install_filter(kernel.make_filter(os.getpid(), threads=self.threads))


def prepare(
    memory_bytes: int,
    cpu_s: int,
    readable: tuple[str, ...] = (),
    listable: tuple[str, ...] = (),
    *,
    threads: bool = False,
) -> Sandbox:
    """Return a sandbox, and let the kernel end this process first where memory runs out.

    In it ``readable`` and ``listable`` can be read beside what every policy may read.

    Its memory counts beyond what is mapped when a process enters it.

    Raises:
        IsolationError: this machine cannot have one, or it does not hold.
    """
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        raise _unavailable("it needs Linux on x86-64")
    abi = kernel.supported_abi()
    if abi == 0:
        raise _unavailable(
            "the kernel has no Landlock, or its use is forbidden here (Linux 5.13 or later has "
            "it; see /sys/kernel/security/lsm)"
        )
    try:
        ruleset = kernel.make_ruleset(abi, (*readable_paths(), *readable), WRITABLE, listable)
    except OSError as error:
        raise _unavailable(f"Landlock refused its rules: {error.strerror}") from error
    sandbox = Sandbox(abi, ruleset, memory_bytes, cpu_s, threads)
    kernel.be_first_to_go()  # children inherit it
    check_holds(sandbox)
    return sandbox


def check_holds(sandbox: Sandbox) -> None:
    """Let a child enter a sandbox and try to break out.

    Raises:
        IsolationError: it could not enter, or got out, or it is unclear whether it could.
    """
    host = os.getpid()
    try:
        with tempfile.NamedTemporaryFile() as file:
            child = os.fork()
            if child == 0:
                try:
                    die_with(host)
                    _try_out(sandbox, file.name)
                finally:
                    os._exit(1)
            status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    except OSError as error:
        raise _unavailable(f"it cannot be tried out: {error.strerror}") from error
    if status == REFUSED:
        raise _unavailable("the kernel refused a part of it")
    if status != ENTERED:
        deed = dict(enumerate(ESCAPES, FIRST_ESCAPE)).get(status)
        other = f"a process that entered it ended with status {status}"
        raise _unavailable(f"a process in it can {deed}" if deed else other)


def _try_out(sandbox: Sandbox, file: str) -> NoReturn:
    """Enter, try each escape, and exit with the code that says how it went."""
    try:
        sandbox.enter(())
    except OSError:
        os._exit(REFUSED)
    for code, attempt in enumerate(ESCAPES.values(), FIRST_ESCAPE):
        try:
            attempt(file)
        except PermissionError:
            continue
        except OSError:
            pass
        os._exit(code)
    os.close(os.open(os.__file__, os.O_RDONLY))  # and Python must be able to go on
    os._exit(ENTERED)


ESCAPES: Mapping[str, Callable[[str], object]] = {
    "list the root folder": lambda _: os.listdir("/"),
    "read /etc/passwd": lambda _: os.open("/etc/passwd", os.O_RDONLY),
    "open a socket": lambda _: socket.socket(),
    "start a process": lambda _: os.fork() or os._exit(0),
    "start a program": lambda _: os.execv("/proc/self/exe", ["x", "-c", ""]),
    "signal another process": lambda _: os.kill(os.getppid(), 0),
    "trace another process": lambda _: kernel.system_call(101, 16, os.getppid(), 0, 0),
    "write a file": lambda file: os.open(file, os.O_WRONLY),
    "empty a file": lambda file: os.open(file, NEITHER_READ_NOR_WRITE | os.O_TRUNC),
}
"""What a process in a sandbox must not be able to do; each is given a file."""


def _unavailable(reason: str) -> IsolationError:
    return IsolationError(f"no sandbox can be had here: {reason}.\n{PRICE}")
