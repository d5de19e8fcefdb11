# SPDX-License-Identifier: Apache-2.0
"""Outcome: how every robot of a plan ended, with reasons and errors."""

import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Codes, Floats, Ids
from fiber_core.outcomes import Outcome, Reason
from fiber_msgs_py.codes import checked_codes
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids, refuse
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["decode", "encode"]

_COLUMNS = {"id": "<u4", "outcome": "<u1", "reason": "<u1", "error": "<f8"}


def encode(
    ids: ArrayLike,
    outcome: ArrayLike,
    reason: ArrayLike,
    error_mm: ArrayLike,
    stamp: PlanStamp,
    session: str | None = None,
) -> PointCloud2:
    """Return the result of a plan as a message.

    Args:
        ids: robot ids, shape (n,).
        outcome: Outcome of each robot, shape (n,).
        reason: Reason of each robot, shape (n,).
        error_mm: distance from fibre to target [mm], nan without a target, shape (n,).
        stamp: names the plan.
        session: id of the session.

    Raises:
        MessageError: an id is out of range or appears twice, a code is unknown, an error is
            negative or infinite, or shapes differ.
    """
    ids = checked_ids(ids, "outcome")
    error_mm = np.asarray(error_mm, dtype=float)
    if error_mm.shape != ids.shape:
        raise MessageError(
            "outcome", f"does not fit {len(ids)} ids", field="shape of error", value=error_mm.shape
        )
    _check_error(ids, error_mm)
    rows = np.empty(len(ids), dtype=list(_COLUMNS.items()))
    rows["id"] = ids
    rows["outcome"] = checked_codes(outcome, Outcome, ids, "outcome", "outcome")
    rows["reason"] = checked_codes(reason, Reason, ids, "outcome", "reason")
    rows["error"] = error_mm / 1e3
    return encode_table(rows, stamp, session)


def decode(message: PointCloud2) -> tuple[Ids, Codes, Codes, Floats]:
    """Return robot ids, Outcome, Reason, and error [mm] (nan without a target), all (n,).

    Raises:
        MessageError: malformed table, a robot twice, an unknown code, or an error that is
            negative or infinite.
    """
    rows = decode_table(message, "outcome", _COLUMNS)
    ids = checked_ids(rows["id"], "outcome")
    outcome = checked_codes(rows["outcome"], Outcome, ids, "outcome", "outcome")
    reason = checked_codes(rows["reason"], Reason, ids, "outcome", "reason")
    with np.errstate(over="ignore", invalid="ignore"):  # what is infinite in mm is refused
        error_mm = rows["error"] * 1e3
    _check_error(ids, error_mm)
    return ids, outcome, reason, error_mm


def _check_error(ids: Ids, error: Floats) -> None:
    refuse((error < 0) | np.isinf(error), "outcome", "error", ids, error, "is not a distance")
