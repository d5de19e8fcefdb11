# SPDX-License-Identifier: Apache-2.0
"""Turns to a stop, which tell the turn of theta of robots that a camera has seen.

Where theta of a robot reaches farther than a whole turn, the place of its fibre leaves two angles,
a turn apart. The robot is ordered to turn towards one end of its range, past the stop of the angle
that is nearer to that end. If the other angle is true, it makes all of that, and a camera then sees
it where only one angle is in range. Else its hard stop holds it on the way, and it turns to the
other end next. The motion is certified as that of every plan. No two neighbours turn at once: a
robot that is held anywhere on its way is then no nearer to a neighbour than the certificate says.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.measured_places import place_robots, require_rest
from fiber_bus_bridge.protocol.turn_limits import full_turn, half_gaps
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.small_turns import check_can_turn, turning_motion
from fiber_bus_bridge.unplaced_robots import LEAST_TURN
from fiber_core.arm_bounds import joints_of_test_turns
from fiber_core.array_types import Floats, Mask, Pairs
from fiber_core.turns_of_theta import PAST_STOP_RAD, turns_in_range

__all__ = ["blocked_text", "stop_turns", "turn_to_stops"]


def stop_turns(
    theta_range: ArrayLike, theta_rad: ArrayLike, way: ArrayLike, chosen: Mask, pairs: Pairs
) -> tuple[Floats, Floats]:
    """Return how far robots turn past a stop, no two neighbours at once.

    Args:
        theta_range: ends of the ranges of theta [rad], shape (n, 2).
        theta_rad: one of the angles at which each arm may stand [rad], shape (n,).
        way: below 0 for the lower stop, above 0 for the upper one, shape (n,).
        chosen: robots that shall turn, shape (n,).
        pairs: pairs of neighbours, rows a < b, shape (p, 2).

    Returns:
        The angle from which all of the turn is within the range [rad], and the turn, past the stop
        of the other angle [rad], 0 for a robot that rests: beside one that turns, with a turn that
        is known, or not chosen, shape (n,) each.
    """
    low, high = np.asarray(theta_range, dtype=float).T
    lowest, highest = turns_in_range(theta_range, theta_rad)
    way = np.asarray(way)
    down = -(lowest - low + PAST_STOP_RAD)
    up = high - highest + PAST_STOP_RAD
    turns = _apart(chosen & (lowest < highest), pairs)
    start_rad = np.where(way < 0, highest, lowest)
    turn_rad = np.where(way < 0, down, up)
    return np.where(turns, start_rad, theta_rad), np.where(turns, turn_rad, 0.0)


def _apart(chosen: Mask, pairs: Pairs) -> Mask:
    """Some of the chosen robots, as many as their order gives, no two of them neighbours."""
    kept = chosen.copy()
    both = pairs[(pairs < len(chosen)).all(axis=1)]
    both = both[chosen[both].all(axis=1)]
    for a, b in sorted(both.tolist()):  # all pairs in which a is second came before
        if kept[a]:
            kept[b] = False
    return kept


def turn_to_stops(
    session: Session, way: ArrayLike, t: float, may_go: Callable[[], bool] = lambda: True
) -> float:
    """Turn theta of robots past a stop that one of their angles has near.

    From the GO on the places of these robots are unknown, as counters count on at a stop: their
    neighbours rest, and test turns and images tell where they are (`turn_unplaced`). Encoders are
    set to the other angle, a turn away, where all of the turn would not be within the limits.

    Args:
        session: the session with the robots.
        way: below 0 for the lower stop, above 0 for the upper one, nan for a robot that rests,
            shape (n,).
        t: earliest time [s].
        may_go: as in Session.start.

    Returns:
        The time at which the buses are free [s].

    Raises:
        SessionError: no robot of these may turn, or its motors cannot, robots move, are stopped or
            have orders, or the session has no buses of its own.
    """
    require_rest(session, "turn to their stops")
    # only test turns find these robots afterwards
    for joint in (0, joints_of_test_turns(session.plane)):
        check_can_turn(session.plane, joint)
    c, robots, units = session.protocol, session.robots, session.units
    way = np.asarray(way, dtype=float)
    asked = np.isfinite(way) & robots["seen"] & robots["known"] & session.plane.enabled
    chosen = asked & ~_cannot_turn(session)
    if not chosen.any():
        raise SessionError(
            blocked_text(session, way)
            or "no robot of these can be commanded and was seen without its turn of theta"
        )
    theta_range, theta_rad = session.plane.limits[:, 0], session.angles[:, 0]
    from_rad, turn_rad = stop_turns(theta_range, theta_rad, way, chosen, c.pairs)
    counts = session.counts.copy()
    counts[:, 0] += np.rint((from_rad - theta_rad) / units.quantum_rad).astype(np.int64)
    there = place_robots(session, counts, turn_rad != 0.0, t, turn_known=False)
    turn = np.where(there, np.trunc(turn_rad / units.quantum_rad), 0).astype(np.int64)
    session.submit(turning_motion(session, turn, turn != 0))
    assert c.plan is not None  # just submitted
    c.plan = replace(c.plan, to_stops=True)
    c.blind_mm = c.of_move_mm  # no image tells yet where the arms will end
    return session.start(t, may_go)


def _cannot_turn(session: Session) -> Mask:
    """Robots that test turns might not find after a turn to a stop.

    They are beside one at an unknown place, or nearer to a neighbour than the margin, with what the
    drive leaves unknown: the certificate then lets them come no closer, and leaves no test turn. Or
    another turn is in range only by the error with which theta was measured.
    """
    c = session.protocol
    lowest, highest = turns_in_range(session.plane.limits[:, 0], session.angles[:, 0])
    little = session.robots["turn_limit"] * LEAST_TURN < full_turn(c)[:, None]
    near = half_gaps(c) < 0.5 * c.safety.margin_mm
    return near | little.any(axis=1) | (lowest == highest)


def blocked_text(session: Session, way: ArrayLike) -> str:
    """Return the line that names a robot that may not turn to a stop, empty if there is none.

    Args:
        session: the session with the robots.
        way: as of turn_to_stops.
    """
    asked = np.isfinite(np.asarray(way, dtype=float)) & session.robots["seen"]
    blocked = np.flatnonzero(asked & _cannot_turn(session))
    if len(blocked) == 0:
        return ""
    return (
        f"{len(blocked)} robots do not turn to a stop, as test turns could not find them there: "
        f"robot {session.plane.ids[blocked[0]]} is beside one at an unknown place, or too near "
        "to a neighbour, or its theta is not known well enough"
    )
