# SPDX-License-Identifier: Apache-2.0
"""Lights: the points of light of one image in the focal plane, fiducials left out."""

from typing import NamedTuple

import numpy as np
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Ints, Mask, Points
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["SeenLights", "decode", "encode"]

_NAME = "lights"
_COLUMNS = {"x": "<f8", "y": "<f8", "seen": "<u2", "merged": "<u1"}
_FAR_M = 100.0


class SeenLights(NamedTuple):
    """Points of light of one image.

    Args:
        places: mean place of each over the exposures [mm], shape (s, 2).
        seen: number of exposures that saw each, shape (s,).
        merged: whether a light may be two that merged, shape (s,).
    """

    places: Points
    seen: Ints
    merged: Mask


def encode(seen: SeenLights, stamp: PlanStamp, session: str | None = None) -> PointCloud2:
    """Return the lights of an image as a message.

    Args:
        seen: the lights.
        stamp: names the plan or motion after which the image was taken.
        session: id of the session of the robots in the image.

    Raises:
        MessageError: shapes differ, or a place is not finite or far off.
    """
    rows = np.empty(len(seen.places), dtype=list(_COLUMNS.items()))
    try:
        rows["x"], rows["y"] = np.asarray(seen.places, dtype=float).reshape(-1, 2).T / 1e3
        rows["seen"], rows["merged"] = seen.seen, seen.merged
    except ValueError as error:
        raise MessageError(_NAME, str(error), field="shapes", value="differ") from error
    _check(rows)
    return encode_table(rows, stamp, session)


def decode(message: PointCloud2) -> SeenLights:
    """Return the lights of an image from a message.

    Raises:
        MessageError: malformed table, or a place is not finite or far off.
    """
    rows = decode_table(message, _NAME, _COLUMNS)
    _check(rows)
    places = 1e3 * np.stack([rows["x"], rows["y"]], axis=1)
    return SeenLights(places, rows["seen"].astype(np.int64), rows["merged"] > 0)


def _check(rows: np.ndarray) -> None:
    bad = ~((np.abs(rows["x"]) < _FAR_M) & (np.abs(rows["y"]) < _FAR_M))
    if bad.any():
        at = int(np.argmax(bad))
        raise MessageError(
            _NAME, f"of row {at} is no place in a plane", field="x, y",
            value=[float(rows["x"][at]), float(rows["y"][at])],
        )  # fmt: skip
