# SPDX-License-Identifier: Apache-2.0
"""What another instrument has measured of robots at rest: where they are, and how well."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.protocol import State
from fiber_bus_bridge.protocol.turn_limits import known_again, learn_gaps
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.wire import encode_place
from fiber_core.array_types import Mask
from fiber_core.clearance import neighbour_pairs
from fiber_core.focal_plane import FocalPlane

__all__ = ["learn_intervals", "place_robots", "require_rest", "widen_outlines"]


def place_robots(
    session: Session,
    counts: ArrayLike,
    chosen: ArrayLike,
    t: float,
    turn_known: ArrayLike = True,
) -> Mask:
    """Tell robots where their joints are.

    Args:
        session: the session with the robots.
        counts: what their encoders shall read [quanta], shape (n, 2).
        chosen: robots that are told, shape (n,).
        t: earliest time [s].
        turn_known: whether theta is told with its turn, one value or shape (n,). A robot at an
            unknown place of which it is not stays out of use, and hinders no other.

    Returns:
        The robots whose encoders read so now, shape (n,).

    Raises:
        SessionError: robots move, are stopped or have orders, the session has no buses of its own,
            or the shapes do not fit.
    """
    require_rest(session, "be told where they are")
    counts, chosen = np.asarray(counts, dtype=np.int64), np.asarray(chosen, dtype=bool)
    if counts.shape != session.counts.shape or chosen.shape != (session.plane.n,):
        raise SessionError(f"places of shape {counts.shape} for {session.plane.n} robots")
    session.protocol.words = None
    told = chosen & session.known & (counts != session.counts).any(axis=1)
    rows = np.flatnonzero(told)
    if len(rows):
        transactions = session.transactions
        transactions.send(rows, encode_place(transactions.addresses[rows], counts[rows]), t)
        session.protocol.read(rows, t)
    there = session.known & (session.counts == counts).all(axis=1)
    robots = session.robots
    placed = there & chosen & robots["unplaced"]
    robots["lost"] &= ~placed
    robots["recalled"] &= ~placed
    # of a robot that was seen before, an image alone does not tell the turn
    robots["unplaced"] &= ~(placed & turn_known & ~robots["seen"])
    robots["seen"] = robots["unplaced"] & (robots["seen"] | placed)
    robots["guessed"] &= robots["unplaced"]
    known_again(session.protocol, placed)
    return there


def widen_outlines(
    session: Session, exact: FocalPlane, theta_mm: ArrayLike, phi_mm: ArrayLike
) -> None:
    """Let the outlines of a session hold arms that are known within an interval only.

    Args:
        session: the session with the robots.
        exact: the plane with outlines as they are.
        theta_mm, phi_mm: how far points of each outline may be from where the angles put them [mm],
            shape (n,) each.

    Raises:
        SessionError: robots move, are stopped or have orders, the session has no buses of its own,
            or a bound is negative or infinite.
    """
    require_rest(session, "get wider outlines")
    wider = np.stack(np.broadcast_arrays(theta_mm, phi_mm, np.zeros(exact.n)))[:2].astype(float)
    wrong = ~(np.isfinite(wider) & (wider >= 0.0)).all(axis=0)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise SessionError(
            f"robot {exact.ids[at]}: outlines cannot grow by {wider[:, at].tolist()} mm"
        )
    context = session.protocol
    context.plane = replace(
        context.plane,
        theta_radius=exact.theta_radius + wider[0],
        phi_radius=exact.phi_radius + wider[1],
    )
    context.pairs = neighbour_pairs(context.plane)


def learn_intervals(session: Session, theta_mm: ArrayLike, phi_mm: ArrayLike) -> None:
    """Take over how far robots at known places are apart, for test turns after a loss of power.

    Args:
        session: the session with the robots.
        theta_mm, phi_mm: as for widen_outlines, as known by the last image alone.
    """
    context = session.protocol
    context.known_mm = np.stack(np.broadcast_arrays(theta_mm, phi_mm, np.zeros(context.plane.n)))[
        :2
    ].T.astype(float)
    context.blind_mm, context.words = np.zeros_like(context.known_mm), None
    learn_gaps(context)


def require_rest(session: Session, what: str) -> None:
    """Refuse a call while robots move, are stopped or have orders.

    Args:
        session: the session with the robots.
        what: what the robots would do or suffer, for the error.

    Raises:
        SessionError: they do, or the session has no buses of its own.
    """
    if not session.has_buses:
        raise SessionError(
            f"robots of sectors cannot {what}: a camera needs one bridge for its plane"
        )
    if session.protocol.state is not State.IDLE:
        raise SessionError(
            f"robots cannot {what} while {session.state.name}: {session.state.value}"
        )
