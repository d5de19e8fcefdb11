# SPDX-License-Identifier: Apache-2.0
"""Robots at unknown places: a test turn that tells a camera where they are, and touches nothing."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.home import turn_motion
from fiber_bus_bridge.measured_places import require_rest
from fiber_bus_bridge.session import Session
from fiber_core.arm_bounds import turn_within

__all__ = ["turn_unplaced"]

_SLOW = 5  # a test turn is so many times slower than theta can


def turn_unplaced(
    session: Session, t: float, up: bool, may_go: Callable[[], bool] = lambda: True
) -> float:
    """Turn theta of the robots at unknown places, so little that nothing can touch.

    All of them stopped under a certificate, which left its margin between outlines. No point of
    an arm moves by more than half of that, wherever the arms are.

    Args:
        session: the session with the robots.
        t: earliest time [s].
        up: whether theta turns towards higher angles.
        may_go: as in Session.start.

    Returns:
        The time at which the buses are free [s].

    Raises:
        SessionError: no robot that can be commanded is at an unknown place, robots move, are
            stopped or have orders, or the session has no buses of its own.
    """
    require_rest(session, "turn at unknown places")
    c, robots = session.protocol, session.robots
    chosen = robots["unplaced"] & ~robots["seen"] & robots["known"] & session.plane.enabled
    if not chosen.any():
        raise SessionError("no robot that can be commanded is at an unknown place")
    gap_mm = c.safety.margin_mm
    turn = np.floor(turn_within(session.plane, gap_mm) / session.units.quantum_rad)
    turn = (1 if up else -1) * turn.astype(np.int64)
    slow = c.speed[:, 0] // _SLOW
    session.submit(turn_motion(session.units, session.counts, turn, slow, chosen))
    assert c.plan is not None  # just submitted
    c.plan = replace(c.plan, within_mm=0.5 * gap_mm)
    return session.start(t, may_go)
