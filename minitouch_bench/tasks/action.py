"""The action that a task applies, from what an agent or a policy gives."""

import numpy as np
from numpy.typing import NDArray

from minitouch_bench.errors import InvalidActionError
from minitouch_bench.protocol.minitouch import PROTOCOL

ACTION_SIZES = tuple(sorted({task.action_size for task in PROTOCOL.tasks}))
"""The numbers of numbers in an action: 4, and in Opening a fifth, the yaw."""

FLOAT_BYTES = (2, 4, 8)
"""Item sizes of the floating types that an action may come in."""


def fit_action(raw: object, size: int) -> NDArray[np.float32]:
    """Return an action as float32 (size,), unclipped.

    A leading batch axis of 1 is dropped. One agent can serve every task: where ``size`` is 4,
    the first 4 of 5 numbers are taken; where it is 5, the fifth is 0 if 4 are given.

    Raises:
        InvalidActionError: no floating-point vector of such a length, or not finite.
    """
    try:
        action = np.asarray(raw)
    except Exception as error:
        raise InvalidActionError("the action is not an array of numbers") from error
    if action.dtype.kind != "f" or action.dtype.itemsize not in FLOAT_BYTES:
        raise InvalidActionError(f"the action is of type {action.dtype}, not floats")
    if action.ndim == 2 and action.shape[0] == 1:
        action = action[0]
    if action.ndim != 1:
        raise InvalidActionError(f"the action has shape {action.shape}, not ({size},)")
    if len(action) not in ACTION_SIZES:
        known = " or ".join(map(str, ACTION_SIZES))
        raise InvalidActionError(f"the action has {len(action)} numbers, not {known}")
    with np.errstate(over="ignore"):  # a float64 too large becomes infinite, and is refused below
        single = action.astype(np.float32)
    if not np.isfinite(single).all():
        raise InvalidActionError("the action contains NaN or infinity")
    fitted = np.zeros(size, np.float32)
    count = min(size, len(single))
    fitted[:count] = single[:count]
    return fitted
