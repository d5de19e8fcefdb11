"""Codes at the border: a number in a table must be a member of its enumeration."""

from enum import IntEnum

import numpy as np

from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import refuse

__all__ = ["checked_codes"]


def checked_codes(values, code: type[IntEnum], ids, name: str, field: str) -> np.ndarray:
    """Return codes as int64, shape (n,).

    Args:
        values: numbers or members, shape (n,).
        code: enumeration they are from.
        ids: robot of each row, shape (n,).
        name: message they are in.
        field: field they are in.

    Raises:
        MessageError: not one code per robot, or a number has no meaning.
    """
    values = np.asarray(values, dtype=np.int64)
    if values.shape != np.shape(ids):
        raise MessageError(
            name, f"does not fit {len(ids)} ids", field=f"shape of {field}", value=values.shape
        )
    unknown = ~np.isin(values, [int(member) for member in code])
    refuse(unknown, name, field, ids, values, f"is no {code.__name__}")
    return values
