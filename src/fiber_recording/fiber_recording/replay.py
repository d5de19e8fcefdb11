# SPDX-License-Identifier: Apache-2.0
"""Follows the frames of a plan as robots do, and returns the motion that robots executed."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.wire import Addresses, Frames, Speeds, decode_load
from fiber_core.array_types import Counts, Ints, Mask, Rows, Times
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording.executed_orders import StartedOrders, started_orders
from fiber_recording.phases import Phase, executed_motion
from fiber_recording.stops import Stops

__all__ = ["Replay", "replay", "unexplained"]

_SAME_START_S = 0.01  # orders that begin this close to each other are of the same phase


@dataclass(frozen=True, eq=False)
class Replay:
    """The motion of a plan, as its frames show it.

    Args:
        phases: the orders that were started, and how far robots got with them; one more for
            each time the robots were resumed after a stop.
        started: robots that received a GO for an order that they stored, shape (n,).
        lost: robots that stopped and sent no position afterwards, shape (n,). If other robots
            of its bus still answer, a lost robot is placed where its last reply said. If no
            robot of the bus answers, none receives a heartbeat either, so all of them stop by
            themselves about when the other robots are stopped; they are placed there.
        changed: robots whose counters changed without motion: they were set after `counts_before`,
            or lost with the power of the robot, shape (n,). Such a change is no part of the motion:
            the robots are shown where their orders lead, from where they were set before them.
        load_bytes: size of the first order of each started robot [bytes], shape (n,), else 0.
        load_s: begin of the first LOAD, in the time of the frames [s], nan without one.
        go_s: begin of the last GO of the first phase [s], nan without one.
        start_s: end of its countdown [s], but for the 0.1 ms that the frame of the GO lasts.
    """

    phases: tuple[Phase, ...]
    started: Mask
    lost: Mask
    changed: Mask
    load_bytes: Ints
    load_s: float
    go_s: float
    start_s: float

    @property
    def motion(self) -> WireMotion:
        """The orders of the first phase, to their end."""
        return self.phases[0].motion

    @property
    def end(self) -> Counts:
        """Encoders after the last phase [quanta], shape (n, 2)."""
        return self.phases[-1].end

    @cached_property
    def executed(self) -> SegmentMotion:
        """The motion that robots executed."""
        return executed_motion(self.phases)

    @property
    def bus_time_s(self) -> float:
        """Time from the first LOAD to the GO [s], 0 without a GO."""
        return float(self.go_s - self.load_s) if np.isfinite(self.go_s) else 0.0


def replay(
    plane: FocalPlane,
    units: WireUnits,
    counts_before: ArrayLike,
    logs: Iterable[FrameLog],
    counts_after: ArrayLike | None = None,
) -> Replay:
    """Follow the frames of a plan as robots do, through stops and resumed motion.

    A robot that did not reach the end of its order is placed where its encoders were afterwards.

    Args:
        plane: the focal plane, with bus and address of every robot.
        units: tick, quantum and field widths of the orders.
        counts_before: encoders before the plan [quanta], shape (n, 2).
        logs: the frames of the plan, in the order in which the buses carried them.
        counts_after: last known encoders [quanta], shape (n, 2), for lost robots; by default
            those in the frames, of which some are missing while robots move.

    Raises:
        FiberError: the frames do not fit the plane.
    """
    log = FrameLog.joined(logs)
    orders, phase_of = _orders_by_phase(plane, log)
    count = int(phase_of.max(initial=-1)) + 1
    begins_s = np.array([orders.begin_s[phase_of == k][0] for k in range(count)])
    frames = Frames(Addresses(log.bus, log.address, log.ten_bit), log.offsets, log.data)
    stops = Stops(plane, log, None if counts_after is None else np.asarray(counts_after))
    next_s = _next_begin_s(orders)
    phases, counts, since_s = [], np.asarray(counts_before), -np.inf
    for k, (begin_s, over_s) in enumerate(zip(begins_s, [*begins_s[1:], np.inf])):
        chosen = np.flatnonzero(phase_of == k)
        chosen = chosen[np.argsort(orders.row[chosen], kind="stable")]
        own = orders.only(chosen)
        counts, since_s = stops.begin(counts, since_s, begin_s), begin_s
        motion = _motion(plane, units, counts, own.row, frames[own.frame])
        phases.append(stops.phase(motion, own, begin_s, next_s[chosen], over_s, begins_s[0]))
        counts = phases[-1].end
    first = orders.only(phase_of == 0)
    started, load_bytes = np.zeros(plane.n, dtype=bool), np.zeros(plane.n, dtype=np.int64)
    orders = orders.only(~orders.cancelled)
    started[orders.row] = True
    load_bytes[orders.row[::-1]] = frames[orders.frame[::-1]].lengths
    return Replay(
        phases=tuple(phases) or (Phase.whole(WireMotion.at_rest(units, counts)),),
        started=started,
        lost=stops.lost,
        changed=stops.changed,
        load_bytes=load_bytes,
        load_s=orders.load_s,
        go_s=float(first.go_s.max()) if count else np.nan,
        start_s=float(begins_s[0]) if count else np.nan,
    )


def _orders_by_phase(plane: FocalPlane, log: FrameLog) -> tuple[StartedOrders, Ints]:
    """Return the started orders in the order of their begin, and the phase of each.

    Orders that begin together were certified together. So a cancelled order belongs to the phase
    of the others, unless all of them were cancelled.
    """
    orders = started_orders(plane, log)
    orders = orders.only(np.argsort(orders.begin_s, kind="stable"))
    phase_of = _numbered(orders.begin_s)
    orders = orders.only(np.isin(phase_of, phase_of[~orders.cancelled]))
    return orders, _numbered(orders.begin_s)


def _numbered(begin_s: Times) -> Ints:
    """Number the begins, which ascend, from 0; the same number for the same start."""
    return np.cumsum(np.diff(begin_s, prepend=-np.inf) > _SAME_START_S) - 1


def _next_begin_s(orders: StartedOrders) -> Times:
    """Return for each order when the next order of its robot begins [s], inf without one."""
    next_s = np.full(len(orders.row), np.inf)
    order = np.lexsort([orders.begin_s, orders.row])
    same_robot = orders.row[order[1:]] == orders.row[order[:-1]]
    next_s[order[:-1][same_robot]] = orders.begin_s[order[1:][same_robot]]
    return next_s


def _motion(
    plane: FocalPlane, units: WireUnits, counts: Counts, rows: Rows, frames: Frames
) -> WireMotion:
    """Return the motion of some robots, rows ascending, from their LOADs; other robots rest."""
    lists = Speeds.of(plane, units)
    orders = decode_load(units, frames, None if lists is None else lists[rows])
    return WireMotion.at_rest(units, counts).with_robots(rows, orders.motion)


def unexplained(
    plane: FocalPlane, followed: Replay, outcome: PlanOutcome, counts: ArrayLike
) -> Mask:
    """Return the robots with other encoders than a replay leads to, shape (n,).

    Args:
        plane: the focal plane.
        followed: the replay of a plan.
        outcome: how the robots ended the plan; one that failed or was stopped is never returned,
            because it may be anywhere.
        counts: encoders now [quanta], shape (n, 2).
    """
    outcome = outcome.of(plane.ids)
    obeyed = (outcome.outcome != Outcome.FAILED) & (outcome.reason != Reason.STOPPED)
    return (followed.end != np.asarray(counts)).any(axis=1) & obeyed
