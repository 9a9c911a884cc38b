"""How a policy is held, from the strictest level to none."""

from enum import StrEnum


class Isolation(StrEnum):
    """How a policy is held."""

    SANDBOX = "sandbox"
    """A process of its own that can reach neither files, network nor other processes."""

    PROCESS = "process"
    """A process of its own, with all the rights of whoever runs the evaluation."""

    NONE = "none"
    """The evaluation's own process, for debugging."""


def weakest(levels: list[Isolation]) -> Isolation:
    """Return the level that holds least."""
    return max(levels, key=list(Isolation).index)
