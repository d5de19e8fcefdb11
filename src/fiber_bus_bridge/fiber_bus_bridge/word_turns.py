# SPDX-License-Identifier: Apache-2.0
"""Turns of phi by code words, which tell a camera which order moves which fibre, and touch nothing.

Robots turn up, down, or back from where they rested before the first turn. No point of an arm is
ever farther from there than half of the gap that its robot had then, at most half of the margin: so
arms that follow their own orders touch nothing, in all turns together. An arm that follows the
orders of another robot moves by half of the margin at most if phi turns, and touches nothing where
its neighbours kept the margin.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.measured_places import require_rest
from fiber_bus_bridge.plan_result import LoadedPlan
from fiber_bus_bridge.protocol.turn_limits import half_gaps
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.small_turns import check_can_turn, turning_motion
from fiber_core.array_types import Counts, Floats, Ints, Mask
from fiber_core.clearance import levers_of

__all__ = ["cannot_turn", "resting_text", "turn_words"]

_LEAST = 2  # a camera tells little of a turn that is shorter than a full one over this number


@dataclass(frozen=True, eq=False)
class _Rest:
    # where robots rested before their first turn, how far they may go from there [mm], (n,), and
    # the phases of the last turn: while a session has this very list, nothing else moved robots
    counts: Counts
    within_mm: Floats
    phases: list[LoadedPlan]


def turn_words(
    session: Session, way: ArrayLike, t: float, may_go: Callable[[], bool] = lambda: True
) -> float:
    """Turn phi of robots up or down, or back to where it rested before the first such turn.

    The first turn after any other motion, or after an image that the robots were told of, begins
    where they rest then. A robot that may not turn far enough rests (`cannot_turn`), as one beside
    a robot at an unknown place does. No order leads out of the range of phi: at its ends a robot
    turns one way only.

    Args:
        session: the session with the robots.
        way: 1 up, -1 down, 0 back, nan for a robot that rests, shape (n,).
        t: earliest time [s].
        may_go: as in Session.start.

    Returns:
        The time at which the buses are free [s].

    Raises:
        SessionError: no robot of these can be commanded and may turn, or its motors cannot, robots
            move, are stopped or have orders, or the session has no buses of its own.
    """
    require_rest(session, "turn by code words")
    check_can_turn(session.plane, 1)
    way = np.asarray(way, dtype=float)
    if way.shape != (session.plane.n,):
        raise SessionError(f"ways of shape {way.shape} for {session.plane.n} robots")
    rest, refused = _rest(session), cannot_turn(session)
    chosen = np.isfinite(way) & session.usable & session.plane.enabled & ~refused
    if not chosen.any():
        raise SessionError(
            resting_text(session, refused)
            if (refused & np.isfinite(way)).any()
            else "no robot that can be commanded is to turn"
        )
    c = session.protocol
    down, up = _far(session, rest)
    wanted = rest.counts[:, 1] + np.where(way > 0.0, up, np.where(way < 0.0, -down, 0))
    turn = np.where(chosen, wanted - session.counts[:, 1], 0)
    session.submit(turning_motion(session, turn, chosen, joint=1))
    assert c.plan is not None  # just submitted
    about = session.units.to_angles(rest.counts)
    c.plan = replace(c.plan, within_mm=rest.within_mm, about=about)
    free_s = session.start(t, may_go)
    c.words = replace(rest, phases=c.loaded_plans)
    return free_s


def _rest(session: Session) -> _Rest:
    """Where robots rested before the first turn, or where they rest now if none has been made."""
    c = session.protocol
    rest = c.words
    if isinstance(rest, _Rest) and rest.phases is c.loaded_plans and _is_near(session, rest):
        return rest
    return _Rest(session.counts.copy(), half_gaps(c), c.loaded_plans)


def _is_near(session: Session, rest: _Rest) -> bool:
    """Whether all robots are where turns by code words can have brought them."""
    off = session.counts - rest.counts
    down, up = _far(session, rest)
    within = (off[:, 0] == 0) & (-down <= off[:, 1]) & (off[:, 1] <= up)
    return bool((within | (off == 0).all(axis=1)).all())


def _far(session: Session, rest: _Rest) -> tuple[Ints, Ints]:
    """How far phi may turn down and up from where it rested [quanta], shape (n,) each."""
    c, phi = session.protocol, rest.counts[:, 1]
    full = np.floor(rest.within_mm / levers_of(c.plane)[:, 1] / session.units.quantum_rad)
    low, high = c.limits[:, 1].T
    turn = full.astype(np.int64)
    return np.minimum(turn, np.maximum(phi - low, 0)), np.minimum(turn, np.maximum(high - phi, 0))


def cannot_turn(session: Session) -> Mask:
    """Return the robots whose gaps allow less than half of a full turn, shape (n,).

    Those at unknown places, and beside them, are among these.

    Args:
        session: the session with the robots.
    """
    least_mm = 0.5 * session.protocol.safety.margin_mm / _LEAST
    return _rest(session).within_mm < least_mm


def resting_text(session: Session, refused: Mask) -> str:
    """Return the line that names robots that rest in turns by code words.

    Args:
        session: the session with the robots.
        refused: these robots, shape (n,), at least one.
    """
    at = int(np.argmax(refused))
    within_mm = float(_rest(session).within_mm[at])
    return (
        f"{refused.sum()} robots rest, as they are at unknown places, beside such robots, or their "
        f"gaps allow no turn that a camera sees: a point of robot {session.plane.ids[at]} may move "
        f"by {within_mm:.4f} mm of {0.5 * session.protocol.safety.margin_mm:.4f} mm"
    )
