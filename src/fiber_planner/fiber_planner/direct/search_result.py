# SPDX-License-Identifier: Apache-2.0
"""What a search of the direct planner returns."""

from typing import NamedTuple

from fiber_core.array_types import Angles, Codes, Floats, Pairs, Times

__all__ = ["SearchResult"]


class SearchResult(NamedTuple):
    """The motion that a search found.

    Args:
        time_s: instants of the motion [s], shape (k + 1,).
        q: joint angles at those instants [rad], shape (b, 2, k + 1), obstacles included.
        goal: as in PlannedMotion, like all that follow.
        reason: OK, or why a robot does not arrive.
        tangled: pairs that start too close.
    """

    time_s: Times
    q: Floats
    goal: Angles
    reason: Codes
    tangled: Pairs
