# SPDX-License-Identifier: Apache-2.0
"""The judge of a kill campaign: what the robots of the plant did, against what was said of them."""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from fiber_bus_bridge.plant import Truth
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.kinematics import forward
from fiber_core.outcomes import Outcome, PlanOutcome
from fiber_msgs_py import PlanStamp, targets

__all__ = ["count_false"]

_TOLERANCE_MM = 0.1 + 1e-3  # session.tolerance_mm, and the rounding of the targets' message


def count_false(
    plane: FocalPlane, outcome: PlanOutcome, sent: Sequence[Any], truth: Truth
) -> int | None:
    """Count the robots that are said to have reached their targets, and stand elsewhere.

    Args:
        plane: the focal plane.
        outcome: the outcome of the plan.
        sent: the messages of targets that came here, of any plan.
        truth: where the robots are.

    Returns:
        Their number; None if the targets of the plan, which may be those of another process, did
        not come here, so that nothing is known of its robots.
    """
    wanted = np.full((plane.n, 2), np.nan)
    for message in sent:
        with suppress(FiberError):  # of a stranger
            if PlanStamp.of(message).ns == outcome.stamp_ns:
                ids, xy_mm = targets.decode(message)
                wanted[plane.index_of(ids)] = xy_mm
    if np.isnan(wanted).all():
        return None
    reached = plane.index_of(outcome.ids[outcome.outcome == Outcome.REACHED])
    at = forward(plane, truth.position * truth.quantum_rad)[1]
    off_mm = np.hypot(*(at[reached] - wanted[reached]).T)
    return int((~(off_mm <= _TOLERANCE_MM)).sum())
