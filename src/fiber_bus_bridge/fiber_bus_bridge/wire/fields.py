# SPDX-License-Identifier: Apache-2.0
"""Types of bytes and whole numbers on the wire, and places of the fields of a record."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = ["Bytes", "Whole", "field_offset"]

Bytes: TypeAlias = NDArray[np.uint8]
Whole: TypeAlias = int | np.int64  # compiled functions take and return both


def field_offset(record: "np.dtype[np.void]", name: str) -> int:
    """Return the byte at which a field of a structured type begins.

    Raises:
        KeyError: the type has no such field.
    """
    places = {str(key): int(value[1]) for key, value in (record.fields or {}).items()}
    return places[name]
