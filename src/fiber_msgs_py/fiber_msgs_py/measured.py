# SPDX-License-Identifier: Apache-2.0
"""Measured: where the robots are after a plan, by the images of a camera."""

from typing import NamedTuple

import numpy as np
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Angles, Codes, Floats, Ids, Points
from fiber_core.outcomes import Verdict
from fiber_msgs_py.codes import checked_codes
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids, refuse
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["REFUSED", "Measured", "decode", "encode"]

REFUSED = "measured refused"  # begin of the text with which the bridge refuses a table

_NAME = "measured"
_LENGTHS = ("x", "y", "error", "theta_wider", "phi_wider")
_ANGLES = ("theta", "phi", "theta_half", "phi_half")
_COLUMNS = {"id": "<u4", "verdict": "<u1"} | dict.fromkeys((*_LENGTHS, *_ANGLES, "doubt"), "<f8")


class Measured(NamedTuple):
    """Where robots are, by images.

    Args:
        ids: robot ids, shape (n,).
        verdict: Verdict on each robot, shape (n,).
        places: measured place of the fibre [mm], nan where none is told, shape (n, 2).
        angles: joint angles, measured or as expected [rad], shape (n, 2).
        half_rad: half the width of the interval of each joint [rad], shape (n, 2).
        error_mm: bound of the error of the place [mm], nan without one, shape (n,).
        doubt: probability that the light is another one's, shape (n,).
        wider_mm: how far points of the theta and phi outlines may be from where the angles put
            them [mm], shape (n, 2).
    """

    ids: Ids
    verdict: Codes
    places: Points
    angles: Angles
    half_rad: Angles
    error_mm: Floats
    doubt: Floats
    wider_mm: Floats


def encode(measured: Measured, stamp: PlanStamp, session: str | None = None) -> PointCloud2:
    """Return what was measured after a plan as a message.

    Args:
        measured: the table.
        stamp: names the plan.
        session: id of the session.

    Raises:
        MessageError: an id is out of range or appears twice, a verdict is unknown, a number is
            negative or not finite that must not be, or shapes differ.
    """
    ids = checked_ids(measured.ids, _NAME)
    columns = {
        "id": ids,
        "verdict": checked_codes(measured.verdict, Verdict, ids, _NAME, "verdict"),
        "doubt": measured.doubt,
        "error": np.asarray(measured.error_mm) / 1e3,
    }
    for names, table, unit in (
        (("x", "y"), measured.places, 1e3),
        (("theta", "phi"), measured.angles, 1.0),
        (("theta_half", "phi_half"), measured.half_rad, 1.0),
        (("theta_wider", "phi_wider"), measured.wider_mm, 1e3),
    ):
        values = np.asarray(table, dtype=float)
        if values.shape != (len(ids), 2):
            raise MessageError(
                _NAME, f"does not fit {len(ids)} ids", field=f"shape of {names}", value=values.shape
            )
        columns |= dict(zip(names, values.T / unit))
    rows = np.empty(len(ids), dtype=list(_COLUMNS.items()))
    for name, values in columns.items():
        if np.shape(values) != ids.shape:
            raise MessageError(
                _NAME, f"does not fit {len(ids)} ids", field=f"shape of {name}",
                value=np.shape(values),
            )  # fmt: skip
        rows[name] = values
    _check(rows)
    return encode_table(rows, stamp, session)


def decode(message: PointCloud2) -> Measured:
    """Return what was measured.

    Raises:
        MessageError: as for encode, or the table is malformed.
    """
    rows = decode_table(message, _NAME, _COLUMNS)
    ids = checked_ids(rows["id"], _NAME)
    verdict = checked_codes(rows["verdict"], Verdict, ids, _NAME, "verdict")
    _check(rows)
    with np.errstate(over="ignore", invalid="ignore"):  # refused above where it matters
        return Measured(
            ids, verdict, 1e3 * _pair(rows, "x", "y"), _pair(rows, "theta", "phi"),
            _pair(rows, "theta_half", "phi_half"), 1e3 * rows["error"], rows["doubt"].copy(),
            1e3 * _pair(rows, "theta_wider", "phi_wider"),
        )  # fmt: skip


def _pair(rows: np.ndarray, one: str, other: str) -> Floats:
    return np.stack([rows[one], rows[other]], axis=1)


def _check(rows: np.ndarray) -> None:
    ids = rows["id"]
    for name in ("theta", "phi"):
        refuse(~np.isfinite(rows[name]), _NAME, name, ids, rows[name], "is not finite")
    for name in ("theta_half", "phi_half", "theta_wider", "phi_wider", "doubt"):
        bad = ~(np.isfinite(rows[name]) & (rows[name] >= 0.0))
        refuse(bad, _NAME, name, ids, rows[name], "is not finite, 0 or more")
    placed = np.isfinite(rows["x"])
    for name in ("y", "error"):
        bad = np.isfinite(rows[name]) != placed
        refuse(bad, _NAME, name, ids, rows[name], "does not fit x: both are told, or none")
    refuse(np.isinf(rows["x"]), _NAME, "x", ids, rows["x"], "is infinite")
    refuse(placed & (rows["error"] < 0.0), _NAME, "error", ids, rows["error"], "is negative")
