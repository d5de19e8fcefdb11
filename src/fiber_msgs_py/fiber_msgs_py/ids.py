# SPDX-License-Identifier: Apache-2.0
"""Check robot ids in messages: whole numbers that fit a message, each once."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Bools, Ids
from fiber_msgs_py.errors import MessageError

__all__ = ["checked_ids", "refuse"]

_LARGEST = 2**32 - 1


def checked_ids(ids: ArrayLike, name: str) -> Ids:
    """Return robot ids as int64, shape (n,), in the order given.

    Args:
        ids: robot ids, shape (n,).
        name: name of the message in an error.

    Raises:
        MessageError: an id is not a whole number 0..2**32 - 1, or appears twice.
    """
    ids = np.asarray(ids)
    if ids.ndim != 1 or (ids.size and ids.dtype.kind not in "iu"):
        raise MessageError(name, "is not a list of ids", field="id", value=ids.tolist())
    ids = ids.astype(np.int64)
    refuse((ids < 0) | (ids > _LARGEST), name, "id", ids, ids, f"is outside 0..{_LARGEST}")
    ordered = np.sort(ids)
    twice = ordered[1:][np.diff(ordered) == 0]
    if twice.size:
        raise MessageError(name, "appears twice", field="id", robot=twice[0], value=twice[0])
    return ids


def refuse(
    bad: Bools, name: str, field: str, ids: ArrayLike, values: ArrayLike, problem: str
) -> None:
    """Raise an error for the first bad row, if there is one.

    Args:
        bad: which rows are bad, shape (n,) or (n, ...).
        name: name of the message in the error.
        field: field of the values in the message.
        ids: robot of each row, shape (n,).
        values: value of each row, shape as bad.
        problem: the problem, in words that follow the value.

    Raises:
        MessageError: a row is bad; names robot and value.
    """
    if np.any(bad):
        at = np.unravel_index(int(np.argmax(bad)), bad.shape)
        robot, value = int(np.asarray(ids)[at[0]]), np.asarray(values)[at].item()
        raise MessageError(name, problem, field=field, robot=robot, value=value)
