"""PyBullet, imported without the line that it writes to stderr whenever it is imported."""

import os
from typing import Any


def _import_pybullet() -> Any:
    saved, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        import pybullet  # noqa: PLC0415  only here can the line be caught

        return pybullet
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)


pybullet: Any = _import_pybullet()
