"""Facts of this machine: its system, processor and Python."""

import platform
from pathlib import Path

CPUINFO = Path("/proc/cpuinfo")
"""What Linux says of each processor, in lines of "name : value"."""


def machine_facts() -> dict[str, str]:
    """Return what a run records of the machine that it was made on."""
    return {
        "system": platform.platform(),
        "processor": processor_model(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
    }


def processor_model() -> str:
    """Return the model of the processor, or its architecture where the system names no model."""
    return _processor_fact("model name") or platform.machine()


def processor_flags() -> frozenset[str]:
    """Return the processor's features, such as "avx512_bf16"; none where the system lists none."""
    return frozenset(_processor_fact("flags").split())


def _processor_fact(name: str) -> str:
    try:
        lines = CPUINFO.read_text(encoding="utf-8").splitlines()
    except OSError:  # macOS
        return ""
    facts = (line.partition(":") for line in lines)
    return next((value.strip() for key, _, value in facts if key.strip() == name), "")
