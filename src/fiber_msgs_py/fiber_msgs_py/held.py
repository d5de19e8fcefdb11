# SPDX-License-Identifier: Apache-2.0
"""Held: the robots of a plan that a stage holds, with reasons.

Each stage publishes its table, even an empty one, before its main output and with the
same stamp.
"""

from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike
from sensor_msgs.msg import PointCloud2

from fiber_core.array_types import Codes, Ids
from fiber_core.outcomes import Reason
from fiber_msgs_py.codes import checked_codes
from fiber_msgs_py.ids import checked_ids
from fiber_msgs_py.stamps import PlanStamp
from fiber_msgs_py.table import decode_table, encode_table

__all__ = ["Stage", "decode", "encode"]

_COLUMNS = {"id": "<u4", "reason": "<u1", "stage": "<u1"}


class Stage(IntEnum):
    """The stage that holds a robot."""

    PLANNER = 0
    DISCRETIZER = 1


def encode(ids: ArrayLike, reason: ArrayLike, stage: Stage, stamp: PlanStamp) -> PointCloud2:
    """Return the robots that a stage holds as a message.

    Args:
        ids: robot ids, shape (n,).
        reason: Reason of each, shape (n,).
        stage: the stage.
        stamp: names the plan.

    Raises:
        MessageError: an id is out of range or appears twice, or a reason is unknown.
    """
    ids = checked_ids(ids, "held")
    rows = np.empty(len(ids), dtype=list(_COLUMNS.items()))
    rows["id"] = ids
    rows["reason"] = checked_codes(reason, Reason, ids, "held", "reason")
    rows["stage"] = Stage(stage)
    return encode_table(rows, stamp)


def decode(message: PointCloud2) -> tuple[Ids, Codes, Codes]:
    """Return robot ids, the Reason and the Stage of each, all shape (n,).

    Raises:
        MessageError: malformed table, a robot twice, or an unknown code.
    """
    rows = decode_table(message, "held", _COLUMNS)
    ids = checked_ids(rows["id"], "held")
    reason = checked_codes(rows["reason"], Reason, ids, "held", "reason")
    return ids, reason, checked_codes(rows["stage"], Stage, ids, "held", "stage")
