"""The one table of policy formats: which file ending and which loader belong to a kind."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from minitouch_bench.errors import MiniTouchError, PolicyLoadError
from minitouch_bench.machine import look_up, require
from minitouch_bench.policies.isolation.levels import Isolation

if TYPE_CHECKING:
    from minitouch_bench.policies.policy import Checkpoint, Policy

Loader = Callable[["Checkpoint"], "Policy"]


@dataclass(frozen=True)
class Format:
    """One way to hand in a policy.

    ``loader`` names a function or a class as ``module:name``, so that no process imports torch but
    the policy's own. ``packages`` are (module, extra) pairs to import beforehand;
    ``computes_with`` is the package whose version the actions depend on, as pip names it.
    ``runs_code`` marks a file that can do whatever its process can, as opposed to data that is
    computed with; ``is_zip`` one whose list of contents is looked at before it is unpacked.
    """

    loader: str
    suffixes: tuple[str, ...] = ()
    packages: tuple[tuple[str, str], ...] = ()
    computes_with: str = ""
    runs_code: bool = False
    is_zip: bool = False


FORMATS: Mapping[str, Format] = {
    "random": Format("minitouch_bench.policies.builtin:RandomPolicy"),
    "zero": Format("minitouch_bench.policies.builtin:ZeroPolicy"),
    "open-loop": Format("minitouch_bench.policies.builtin:OpenLoopPolicy"),
    "native": Format(
        "minitouch_bench.policies.native:load_native", (".safetensors",), computes_with="torch"
    ),
    "torchscript": Format(
        "minitouch_bench.policies.torchscript:load_torchscript",
        (".pt", ".ts"),
        computes_with="torch",
        runs_code=True,
        is_zip=True,
    ),
    "onnx": Format(
        "minitouch_bench.policies.onnx_policy:load_onnx",
        (".onnx",),
        (("onnx", "onnx"), ("onnxruntime", "onnx")),
        computes_with="onnxruntime",
    ),
    "sb3": Format(
        "minitouch_bench.policies.sb3:load_sb3",
        (".zip",),
        (("stable_baselines3", "sb3"),),
        computes_with="stable-baselines3",
        runs_code=True,
        is_zip=True,
    ),
    "factory": Format(
        "minitouch_bench.policies.python_objects:load_factory", packages=(("torch", "all"),)
    ),
    "remote": Format("minitouch_bench.policies.server:load_remote"),
    "in memory": Format("minitouch_bench.policies.python_objects:load_object"),
}

BUILT_IN = ("random", "zero", "open-loop", "scripted")
"""Policies known by name; ``scripted`` has no loader, it runs beside the simulator."""

KIND_BY_SUFFIX: Mapping[str, str] = {
    suffix: kind for kind, form in FORMATS.items() for suffix in form.suffixes
}


def computing_packages() -> tuple[str, ...]:
    """Return the packages whose versions a policy's actions can depend on, as pip names them."""
    names = (form.computes_with for form in FORMATS.values())
    return tuple(dict.fromkeys(filter(None, names)))


def check_permitted(kind: str, target: str, isolation: Isolation, *, trust: bool) -> None:
    """Refuse a policy that would run code of its own where nothing holds it.

    Raises:
        PolicyLoadError: it is neither in the sandbox nor trusted.
    """
    if kind == "factory" and not trust:
        raise PolicyLoadError(f"'{target}' runs Python code: it needs --trust")
    if FORMATS[kind].runs_code and isolation is not Isolation.SANDBOX and not trust:
        raise PolicyLoadError(
            f"{target} is {kind}, which can run code of its own on this machine.\n"
            "Leave it to --isolation sandbox, or if you trust it, add --trust"
        )


def find_loader(kind: str) -> Loader:
    """Import what a kind needs and return its loader.

    Raises:
        MissingExtraError: an optional package of the format is not installed.
    """
    form = FORMATS[kind]
    for module, extra in form.packages:
        require(module, extra)
    loader: Loader = look_up(form.loader)
    return loader


def load_policy(kind: str, checkpoint: "Checkpoint") -> "Policy":
    """Build the policy of a checkpoint.

    Raises:
        PolicyLoadError: the checkpoint is unreadable, unsafe or of the wrong form.
        MissingExtraError: an optional package of the format is not installed.
    """
    loader = find_loader(kind)
    try:
        return loader(checkpoint)
    except MiniTouchError:
        raise
    except Exception as error:  # whatever a foreign reader raises means: not loadable
        from minitouch_bench.policies.wire import describe  # noqa: PLC0415  it imports numpy

        raise PolicyLoadError(
            f"{checkpoint.target} is not a readable {kind} policy: {describe(error)}"
        ) from error
