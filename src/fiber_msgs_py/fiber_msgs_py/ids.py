"""Robot ids at the border: whole numbers that fit a message, each named once."""

import numpy as np

from fiber_msgs_py.errors import MessageError

__all__ = ["checked_ids", "refuse"]

_LARGEST = 2**32 - 1


def checked_ids(ids, name: str) -> np.ndarray:
    """Return robot ids as int64, shape (n,), in the order given.

    Args:
        ids: robot ids, shape (n,).
        name: message they are in.

    Raises:
        MessageError: an id is not a whole number 0..2**32 - 1, or is there twice.
    """
    ids = np.asarray(ids)
    if ids.ndim != 1 or (ids.size and ids.dtype.kind not in "iu"):
        raise MessageError(name, "is not a list of ids", field="id", value=ids.tolist())
    ids = ids.astype(np.int64)
    refuse((ids < 0) | (ids > _LARGEST), name, "id", ids, ids, f"is outside 0..{_LARGEST}")
    ordered = np.sort(ids)
    twice = ordered[1:][np.diff(ordered) == 0]
    if twice.size:
        raise MessageError(name, "is there twice", field="id", robot=twice[0], value=twice[0])
    return ids


def refuse(bad, name: str, field: str, ids, values, problem: str) -> None:
    """Raise for the first row that is bad.

    Args:
        bad: which rows are, shape (n,) or (n, ...).
        name: message they are in.
        field: field the values are from.
        ids: robot of each row, shape (n,).
        values: value of each row, shape as bad.
        problem: what is wrong with it.

    Raises:
        MessageError: a row is bad; names robot and value.
    """
    bad = np.asarray(bad)
    if bad.any():
        at = np.unravel_index(int(np.argmax(bad)), bad.shape)
        raise MessageError(
            name, problem, field=field, robot=int(ids[at[0]]), value=np.asarray(values)[at].item()
        )
