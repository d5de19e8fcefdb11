# SPDX-License-Identifier: Apache-2.0
"""Check codes in messages: a number in a table must be a member of its enumeration."""

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Codes, Ids
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import refuse

__all__ = ["checked_codes"]


def checked_codes(values: ArrayLike, code: type[IntEnum], ids: Ids, name: str, field: str) -> Codes:
    """Return codes as int64, shape (n,).

    Args:
        values: numbers or members, shape (n,).
        code: the enumeration.
        ids: robot of each row, shape (n,).
        name: name of the message in an error.
        field: field of the codes in the message.

    Raises:
        MessageError: not one code for each robot, or a number is not a member.
    """
    values = np.asarray(values, dtype=np.int64)
    if values.shape != np.shape(ids):
        raise MessageError(
            name, f"does not fit {len(ids)} ids", field=f"shape of {field}", value=values.shape
        )
    unknown = ~np.isin(values, [int(member) for member in code])
    refuse(unknown, name, field, ids, values, f"is not a member of {code.__name__}")
    return values
