# SPDX-License-Identifier: Apache-2.0
"""Robots at unknown places: a test turn that tells a camera where they are, and touches nothing."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.measured_places import require_rest
from fiber_bus_bridge.protocol.turn_limits import as_theta, as_turned, full_turn
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.small_turns import check_can_turn, turning_motion
from fiber_core.arm_bounds import joints_of_test_turns
from fiber_core.array_types import Ints, Mask
from fiber_core.clearance import levers_of

__all__ = ["LEAST_TURN", "refused_text", "turn_unplaced", "turns_of"]

LEAST_TURN = 2  # a camera tells little of a turn that is shorter than a full one over this number


def turn_unplaced(session: Session, t: float, may_go: Callable[[], bool] = lambda: True) -> float:
    """Turn a joint of the robots at unknown places, so little that nothing can touch.

    Robots with both elbows in range turn phi, as theta does not tell the elbow; the others theta.

    No point of an arm moves by more than half of the gap that the last certificate left, wherever
    the arms are, in all turns together (`protocol.turn_limits`). All turn one way, that in which
    more robots may turn: lights that two robots reach then move in different directions. A robot
    that may not, rests.

    Args:
        session: the session with the robots.
        t: earliest time [s].
        may_go: as in Session.start.

    Returns:
        The time at which the buses are free [s].

    Raises:
        SessionError: no robot that can be commanded is at an unknown place and may turn, its motors
            cannot make such turns, robots move, are stopped or have orders, or the session has no
            buses of its own.
    """
    require_rest(session, "turn at unknown places")
    c = session.protocol
    check_can_turn(session.plane, joints_of_test_turns(session.plane))
    turn, refused = turns_of(session)
    joint, every = joints_of_test_turns(session.plane), np.arange(session.plane.n)
    if not turn.any():
        raise SessionError(
            refused_text(session, refused)
            if refused.any()
            else "no robot that can be commanded is at an unknown place"
        )
    session.submit(turning_motion(session, turn, turn != 0, joint))
    assert c.plan is not None  # just submitted
    within_mm = np.abs(turn) * session.units.quantum_rad * levers_of(session.plane)[every, joint]
    c.plan = replace(c.plan, within_mm=within_mm)
    return session.start(t, may_go)


def turns_of(session: Session) -> tuple[Ints, Mask]:
    """Return the test turn of each robot, and the robots that may not turn far enough.

    Args:
        session: the session with the robots.

    Returns:
        The turns [quanta], 0 for none, of the joint of each (`joints_of_test_turns`), and the
        robots at unknown places that rest: turns before have used up half of their gaps, or their
        ranges end, the way that most may turn, shape (n,) each.
    """
    c, robots = session.protocol, session.robots
    chosen = robots["unplaced"] & ~robots["seen"] & robots["known"] & session.plane.enabled
    full, joint, every = full_turn(c), joints_of_test_turns(session.plane), np.arange(len(robots))
    low, high = c.limits[every, joint].T
    at = robots["counts"][every, joint]
    to_stop = as_theta(c, np.maximum(np.stack([at - low, high - at], axis=1), 0))
    # from one end of what a robot may turn to the other one, where elbows are to be told
    most = full * np.where(joint == 1, 2, 1)
    may = np.minimum(np.minimum(robots["turn_limit"], to_stop), most[:, None])
    far = (may * LEAST_TURN >= full[:, None]) & chosen[:, None]
    way = int(np.argmax(far.sum(axis=0)[::-1]))  # up where as many robots may
    turn = np.where(far[:, 1 - way], as_turned(c, may[:, 1 - way]), 0)
    return turn if way == 0 else -turn, chosen & (turn == 0)


def refused_text(session: Session, refused: Mask) -> str:
    """Return the line that names robots at unknown places that rest in a test turn.

    Args:
        session: the session with the robots.
        refused: these robots, shape (n,), at least one.
    """
    at = int(np.argmax(refused))
    degrees = np.degrees(session.units.quantum_rad)
    down, up = session.robots["turn_limit"][at] * degrees
    return (
        f"{refused.sum()} robots at unknown places rest, as their gaps allow no longer turn the "
        f"way of the others: robot {session.plane.ids[at]} may turn by {down:.3f} deg down and "
        f"{up:.3f} deg up of {full_turn(session.protocol)[at] * degrees:.3f} deg"
    )
