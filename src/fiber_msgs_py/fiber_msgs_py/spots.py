# SPDX-License-Identifier: Apache-2.0
"""Spots: the points of light in one exposure of a camera; and what its calibration saw.

The stamp of both is the time of the camera, not that of a plan.
"""

import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Floats, Mask, Points
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["decode", "decode_calibration", "encode", "encode_calibration"]

_COLUMNS: dict[str, str] = {"u": "<f8", "v": "<f8", "flux": "<f8", "width": "<f8"}
_CALIBRATION: dict[str, str] = {
    "x": "<f8", "y": "<f8", "u": "<f8", "v": "<f8", "fiducial": "<u1"
}  # fmt: skip
_FAR_M = 100.0


def encode(
    place_px: ArrayLike, flux: ArrayLike, width_px: ArrayLike, stamp: PlanStamp
) -> PointCloud2:
    """Return the spots of an exposure as a message.

    Args:
        place_px: centroids, column and row [px], shape (s, 2).
        flux: light of each [counts], shape (s,).
        width_px: rms radius along one axis [px], shape (s,).
        stamp: time of the exposure.

    Raises:
        MessageError: the shapes differ.
    """
    places = np.asarray(place_px, dtype=float).reshape(-1, 2)
    rows = np.empty(len(places), dtype=list(_COLUMNS.items()))
    rows["u"], rows["v"] = places.T
    for name, values in (("flux", flux), ("width", width_px)):
        if np.shape(values) != (len(places),):
            raise MessageError(
                "spots", f"does not fit {len(places)} places", field=f"shape of {name}",
                value=np.shape(values),
            )  # fmt: skip
        rows[name] = values
    return encode_table(rows, stamp)


def decode(message: PointCloud2) -> tuple[Floats, Floats, Floats]:
    """Return centroids [px], shape (s, 2), light [counts] and width [px], shape (s,).

    Raises:
        MessageError: malformed table.
    """
    rows = decode_table(message, "spots", _COLUMNS)
    return np.stack([rows["u"], rows["v"]], axis=1), rows["flux"].copy(), rows["width"].copy()


def encode_calibration(
    plane_mm: ArrayLike, place_px: ArrayLike, fiducial: ArrayLike, stamp: PlanStamp
) -> PointCloud2:
    """Return the lights by which a camera was calibrated, and the fiducials, as a message.

    Args:
        plane_mm: where each light is in the focal plane [mm], shape (k, 2).
        place_px: where the calibration saw it [px], shape (k, 2), nan for a fiducial that it did
            not see.
        fiducial: whether it is a fiducial that images show, shape (k,).
        stamp: time of the calibration.

    Raises:
        MessageError: the shapes differ, or a place in the plane is not finite or far off.
    """
    rows = np.zeros(len(np.asarray(plane_mm)), dtype=list(_CALIBRATION.items()))
    try:
        rows["x"], rows["y"] = np.asarray(plane_mm, dtype=float).T / 1e3
        rows["u"], rows["v"] = np.asarray(place_px, dtype=float).T
        rows["fiducial"] = fiducial
    except ValueError as error:
        raise MessageError("calibration", str(error), field="shapes", value="differ") from error
    _check(rows)
    return encode_table(rows, stamp)


def decode_calibration(message: PointCloud2) -> tuple[Points, Floats, Mask]:
    """Return the lights as for encode_calibration: places [mm] and [px], and which are fiducials.

    Raises:
        MessageError: malformed table, or a place in the plane is not finite or far off.
    """
    rows = decode_table(message, "calibration", _CALIBRATION)
    _check(rows)
    plane_mm = 1e3 * np.stack([rows["x"], rows["y"]], axis=1)
    return plane_mm, np.stack([rows["u"], rows["v"]], axis=1), rows["fiducial"] > 0


def _check(rows: np.ndarray) -> None:
    bad = ~((np.abs(rows["x"]) < _FAR_M) & (np.abs(rows["y"]) < _FAR_M))
    if bad.any():
        at = int(np.argmax(bad))
        raise MessageError(
            "calibration", f"of row {at} is no place in a plane", field="x, y",
            value=[float(rows["x"][at]), float(rows["y"][at])],
        )  # fmt: skip
