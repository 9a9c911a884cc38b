"""In which formats a policy can be handed in."""

from collections.abc import Mapping
from dataclasses import dataclass

from minitouch_bench.episode import IN_MEMORY


@dataclass(frozen=True)
class Format:
    """One way to hand in a policy.

    ``loader`` names a function or a class of this package as ``module:name``, so that no process
    imports torch but the policy's own. ``packages`` are (module, extra) pairs to import beforehand;
    ``computes_with`` is the package whose version the actions depend on, as pip names it.
    ``runs_code`` marks a zip with pickles, which can do whatever its process can, as opposed to
    data that is computed with; its list of contents is looked at before it is unpacked.
    ``advice`` is shown once to a user who evaluates such a file.
    """

    loader: str
    suffixes: tuple[str, ...] = ()
    packages: tuple[tuple[str, str], ...] = ()
    computes_with: str = ""
    runs_code: bool = False
    advice: str = ""


FORMATS: Mapping[str, Format] = {
    "random": Format("python_objects:RandomPolicy"),
    "zero": Format("python_objects:ZeroPolicy"),
    "open-loop": Format("python_objects:OpenLoopPolicy"),
    "native": Format("native:load_native", (".safetensors",), computes_with="torch"),
    "torch.export": Format(
        "torch_programs:load_exported",
        (".pt2",),
        (("torch.export.pt2_archive._package", "all"),),
        computes_with="torch",
        runs_code=True,
    ),
    "torchscript": Format(
        "torch_programs:load_torchscript",
        (".pt", ".ts"),
        computes_with="torch",
        runs_code=True,
        advice="TorchScript is deprecated since PyTorch 2.11: .pt and .ts are still read here; "
        "save new policies with torch.export (.pt2)",
    ),
    "onnx": Format(
        "onnx_policy:load_onnx",
        (".onnx",),
        (("onnx", "onnx"), ("onnxruntime", "onnx")),
        computes_with="onnxruntime",
    ),
    "sb3": Format(
        "sb3:load_sb3",
        (".zip",),
        (("stable_baselines3", "sb3"),),
        computes_with="stable-baselines3",
        runs_code=True,
    ),
    "lerobot": Format(
        "lerobot:load_lerobot",
        (".lerobot",),  # a directory in one file, as submissions have it
        (
            ("lerobot.policies.act.modeling_act", "lerobot"),
            ("lerobot.policies.diffusion.modeling_diffusion", "lerobot"),
        ),
        computes_with="lerobot",
    ),
    "factory": Format("python_objects:load_factory", packages=(("torch", "all"),)),
    "remote": Format("server:load_remote"),
    IN_MEMORY: Format("python_objects:load_object"),
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
