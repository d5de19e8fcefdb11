# SPDX-License-Identifier: Apache-2.0
"""True places: where the fibres of a simulated plane really are as its camera takes an image.

Only recordings use them, to show them beside what was measured.
"""

from typing import NamedTuple

import numpy as np
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Ids, Points
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids, refuse
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["TruePlaces", "decode", "encode"]

_NAME = "true places"
_COLUMNS = {"id": "<u4", "x": "<f8", "y": "<f8"}
_FAR_M = 100.0


class TruePlaces(NamedTuple):
    """Where fibres are.

    Args:
        ids: robot ids, shape (n,).
        places: places of the fibres [mm], shape (n, 2).
    """

    ids: Ids
    places: Points


def encode(true: TruePlaces, stamp: PlanStamp) -> PointCloud2:
    """Return true places as a message, stamped with the time of the image.

    Raises:
        MessageError: an id does not fit the wire, or a shape does not fit the ids.
    """
    rows = np.empty(len(true.ids), dtype=list(_COLUMNS.items()))
    rows["id"] = checked_ids(true.ids, _NAME)
    places = np.asarray(true.places, dtype=float)
    if places.shape != (len(rows), 2):
        raise MessageError(
            _NAME, f"does not fit {len(rows)} robots", field="shape of places", value=places.shape
        )
    rows["x"], rows["y"] = places.T / 1e3
    return encode_table(rows, stamp)


def decode(message: PointCloud2) -> TruePlaces:
    """Return true places from a message.

    Raises:
        MessageError: malformed table, an id appears twice, or a place is not finite or far off.
    """
    rows = decode_table(message, _NAME, _COLUMNS)
    ids = checked_ids(rows["id"], _NAME)
    for name in ("x", "y"):
        refuse(
            ~(np.abs(rows[name]) < _FAR_M), _NAME, name, ids, rows[name], "is no place in a plane"
        )
    return TruePlaces(ids, 1e3 * np.stack([rows["x"], rows["y"]], axis=1))
