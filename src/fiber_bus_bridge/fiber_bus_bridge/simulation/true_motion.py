# SPDX-License-Identifier: Apache-2.0
"""True motion of the simulated robots, for judges that must not believe the robots' reports.

The motion of the counters is what the robots did with their orders. Motors with a ramp spread each
change of speed over it, so the arms come after their counters and stand where these read when a
ramp has passed; and they follow as their `Mechanics` let them.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import BusBackend, Recovery, Replies
from fiber_bus_bridge.simulation.mechanics import Mechanics
from fiber_bus_bridge.simulation.memory import Memory
from fiber_bus_bridge.simulation.positioners import Positioners
from fiber_bus_bridge.simulation.true_arms import ArmState, arms_motion
from fiber_bus_bridge.wire import Frames, RobotState
from fiber_bus_bridge.wire.fields import number
from fiber_bus_bridge.wire.speed_block import number_of
from fiber_core.array_types import Counts, Floats, Ints, Rows
from fiber_core.drive.curves import CurveMotion, spread_out
from fiber_core.motion import SegmentMotion
from fiber_core.ragged import Parts

__all__ = ["CounterMotion", "Movements", "ObservedBuses", "TrueMotion"]

_TOGETHER_S = 0.01  # between the first and the last start of one motion


class CounterMotion(NamedTuple):
    """The motion of the counters of a plane, and what its motors make of each segment.

    Args:
        segments: the motion of the counters.
        movement: the movement that each segment belongs to, by its number among those of its
            robot, from 0, -1 for a wait between two, shape (m,).
        ramp_s: the time over which the motor spreads each segment [s], shape (m,).
    """

    segments: SegmentMotion
    movement: Ints
    ramp_s: Floats


class Movements(NamedTuple):
    """Movements of robots, one row each, in the order in which they were observed.

    Args:
        row: the robot, shape (r,).
        started_s: start [s], shape (r,).
        ended_s: end, completed or broken off [s], nan while the robot moves, shape (r,).
        tick_s: duration of a tick of the robot's clock [s], shape (r,).
        counts: numbers of segments of theta and phi, shape (r, 2).
        ticks: durations [ticks], shape (r, 2, MAX_SEGMENTS).
        velocity: speeds [velocity units], shape (r, 2, MAX_SEGMENTS).
        ramp_us: ramps of the motors at these speeds [us], 0 without, shape (r, 2, MAX_SEGMENTS).
    """

    row: Rows
    started_s: Floats
    ended_s: Floats
    tick_s: Floats
    counts: Ints
    ticks: Ints
    velocity: Ints
    ramp_us: Ints

    def motion(
        self, start: Counts, quantum_rad: float, until_s: float, begin_s: float = 0.0
    ) -> SegmentMotion | CurveMotion:
        """Return the motion of the arms of a plane that these movements make, without errors.

        Args:
            start: encoders before the first movement [quanta], shape (n, 2).
            quantum_rad: size of one encoder count [rad].
            until_s: end of the motion [s]; a movement without an end goes on until then.
            begin_s: time zero of the motion [s], before any movement.
        """
        counters = self.counters(start, quantum_rad, until_s, begin_s)
        return spread_out(counters.segments, counters.ramp_s)

    def counters(
        self, start: Counts, quantum_rad: float, until_s: float, begin_s: float = 0.0
    ) -> CounterMotion:
        """Return the motion of the counters that these movements make.

        The arguments are those of `motion`.
        """
        ended_s = np.where(np.isnan(self.ended_s), until_s, self.ended_s)
        # copies: one type of arrays, wherever they come from
        row, counts, ticks, velocity, ramp_us = (
            np.array(each, dtype=np.int64)
            for each in (self.row, self.counts, self.ticks, self.velocity, self.ramp_us)
        )
        started_s, tick_s = (np.array(each, dtype=float) for each in (self.started_s, self.tick_s))
        owner, duration, speed, movement, ramp = _pieces(
            len(start), row, started_s, ended_s, tick_s, counts, ticks, velocity, ramp_us,
            float(quantum_rad), float(begin_s),
        )  # fmt: skip
        order = np.argsort(owner, kind="stable")
        offsets = Parts.from_owners(owner[order], 2 * len(start)).offsets
        motion = SegmentMotion(start * quantum_rad, offsets, duration[order], speed[order])
        return CounterMotion(motion, movement[order], 1e-6 * ramp[order])


@njit(cache=True)
def _pieces(
    n: int, rows: Rows, started_s: Floats, ended_s: Floats, tick_s: Floats,
    counts: Ints, ticks: Ints, velocity: Ints, ramp_us: Ints, quantum_rad: float, begin_s: float,
) -> tuple[Ints, Floats, Floats, Ints, Ints]:  # fmt: skip
    """Return owner, duration, speed, movement and ramp of all segments, movement by movement.

    A joint waits for its movement, turns segment by segment until the movement ends, and rests for
    what is left of it. Pieces that last no time are left out.
    """
    most = len(rows) * (2 * ticks.shape[2] + 4)
    owner, movement, ramp = np.empty((3, most), dtype=np.int64)
    duration, speed = np.empty((2, most))
    now, begun, used = np.full(n, begin_s), np.zeros(n, dtype=np.int64), 0
    for k in range(len(rows)):
        row, lasts_s = rows[k], ended_s[k] - started_s[k]
        if lasts_s <= 0.0:
            continue  # broken off in its countdown
        for joint in range(2):
            owner[used], duration[used] = 2 * row + joint, started_s[k] - now[row]
            speed[used], movement[used], ramp[used] = 0.0, -1, 0
            used += duration[used] > 0.0
            end = before = 0.0
            for m in range(counts[k, joint] + 1):
                rests = m == counts[k, joint]  # for what is left
                end = np.inf if rests else end + ticks[k, joint, m] * tick_s[k]
                owner[used], duration[used] = 2 * row + joint, min(end, lasts_s) - before
                speed[used] = 0.0 if rests else velocity[k, joint, m] * quantum_rad / tick_s[k]
                movement[used] = begun[row]
                ramp[used] = 0 if rests else ramp_us[k, joint, m]
                before = min(end, lasts_s)
                used += duration[used] > 0.0
        now[row] = ended_s[k]
        begun[row] += 1
    return owner[:used], duration[:used], speed[:used], movement[:used], ramp[:used]


@njit(cache=True)
def _ramps(copies: Memory) -> Ints:
    """Return the ramps of the running order of robots [us], shape (r, 2, MAX_SEGMENTS).

    They are those that the robots took from their CONFIG: of a robot with a list of speeds that of
    the speed of each segment, and of one that has none 0.
    """
    found = np.zeros((len(copies), 2, copies[0].ticks.shape[1]), dtype=np.int64)
    for k in range(len(copies)):
        r = copies[k]
        if r.ramp_bytes == 0:
            continue
        for joint in range(2):
            for m in range(r.counts[joint]):
                speed = 0
                if r.listed_bytes > 0:
                    speed = number_of(r.listed, 0, r.velocity[joint, m], joint)
                if speed >= 0:  # a rest has no speed
                    found[k, joint, m] = number(r.ramps, 4 * speed, 4)
    return found


def _turned(r: np.void) -> Counts:
    """Return how far the last movement of a robot went [quanta], shape (2,)."""
    left = (r["halted_s"] - r["started_s"]) * (1e6 + r["clock_ppm"]) / max(r["tick_us"], 1)
    used = np.arange(r["ticks"].shape[1]) < r["counts"][:, None]
    ends = np.cumsum(r["ticks"] * used, axis=1)
    done = np.diff(np.minimum(ends, max(left, 0.0)), axis=1, prepend=0)
    return np.rint((done * r["velocity"] * used).sum(axis=1)).astype(np.int64)


@njit(cache=True)
def _has_news(memory, last_started_s, open_, go_s):
    # whether a robot has started, or a movement that was observed has ended
    for row in range(len(memory)):
        r = memory[row]
        if r.started_s != last_started_s[row] or (open_[row] >= 0 and r.halted_s > go_s[row]):
            return True
    return False


class TrueMotion:
    """The true motion of all robots, observed from now on.

    `observe` must be called after every call that can start a robot, before another call can
    start the robot again: once for each batch of frames is enough.

    Args:
        robots: the robots. The motion of those that move is observed from its begin.
        quantum_rad: size of one encoder count [rad].
        kept: number of movements that are kept; older ones that have ended are forgotten.
    """

    def __init__(self, robots: Positioners, quantum_rad: float, kept: int | None = None):
        self._robots, self.quantum_rad, self._kept = robots, quantum_rad, kept
        memory = robots.memory
        self._start = memory["position"].copy()
        self._last_started_s = memory["started_s"].copy()
        self._open = np.full(robots.n, -1)  # number of the movement of each robot that moves
        self._go_s = np.full(robots.n, np.inf)
        self.forgotten = 0  # number of the first movement that is kept
        self._rows: list[int] = []
        self._ended: list[float] = []
        self._rest: list[Counts] = []  # encoders after each movement
        self._copies: list[Memory] = []
        moving = memory["state"] == RobotState.MOVING
        self._has_ended = np.zeros(robots.n, dtype=bool)  # before it was observed
        if moving.any():
            # robots that moved together with those that move, and have ended
            with_them = memory["started_s"] > memory["started_s"][moving].min() - _TOGETHER_S
            for row in np.flatnonzero(with_them & ~moving):
                self._start[row] -= _turned(memory[row])
            self._last_started_s[with_them] = -np.inf
            self._has_ended = with_them & ~moving

    @property
    def count(self) -> int:
        """Number of movements observed, with those forgotten."""
        return self.forgotten + len(self._rows)

    def rows_from(self, number: int) -> Rows:
        """Return the robots of all movements from a number on, shape (r,)."""
        return np.array(self._rows[number - self.forgotten :], dtype=np.int64)

    def observe(self) -> None:
        """Record the robots that have started or stopped since the last call."""
        memory = self._robots.memory
        if not _has_news(memory, self._last_started_s, self._open, self._go_s):
            return
        self._close_ended()
        for row in np.flatnonzero(memory["started_s"] != self._last_started_s):
            self._last_started_s[row] = memory["started_s"][row]
            # heartbeats go on after the end of a movement that is over already
            self._go_s[row] = -np.inf if self._has_ended[row] else memory["heartbeat_s"][row]
            self._has_ended[row] = False
            self._open[row] = self.count
            self._rows.append(int(row))
            self._ended.append(np.nan)
            self._rest.append(memory["position"][row].copy())
            self._copies.append(memory[row].copy())
        self._close_ended()
        if self._kept is not None and len(self._rows) > 2 * self._kept:
            self._forget(self.count - self._kept)

    def _close_ended(self) -> None:
        # a movement broken off in its countdown ended before it began, but after the GO
        halted_s = self._robots.memory["halted_s"]
        for row in np.flatnonzero((self._open >= 0) & (halted_s > self._go_s)):
            at = self._open[row] - self.forgotten
            self._ended[at] = halted_s[row]
            self._rest[at] = self._robots.memory["position"][row].copy()
            self._open[row] = -1

    def _closed_before(self, number: int) -> int:
        """The largest number up to `number` before which all movements have ended."""
        return int(min(number, self._open[self._open >= 0].min(initial=self.count)))

    def _start_before(self, number: int) -> Counts:
        """Encoders before the movement of a number, of which all earlier ones have ended."""
        start = self._start.copy()
        for row, rest in zip(self._rows[: number - self.forgotten], self._rest):
            start[row] = rest
        return start

    def _forget(self, before: int) -> None:
        before = self._closed_before(before)
        self._start = self._start_before(before)
        for column in (self._rows, self._ended, self._rest, self._copies):
            del column[: before - self.forgotten]
        self.forgotten = before

    def since(self, number: int = 0) -> tuple[int, Counts, Movements]:
        """Return the movements observed so far from a number on, and where the robots began.

        Args:
            number: number of the first movement; earlier ones that have not ended are returned too,
                those that were forgotten are not.

        Returns:
            The number of the first movement returned, the encoders before it [quanta], shape
            (n, 2), and the movements.
        """
        first = self._closed_before(min(max(number, self.forgotten), self.count))
        at = slice(first - self.forgotten, None)
        copies = np.array(self._copies[at], dtype=self._robots.memory.dtype)
        tick_s = copies["tick_us"] / (1e6 + copies["clock_ppm"])
        row = np.array(self._rows[at], dtype=np.int64)
        ended_s = np.array(self._ended[at], dtype=float)
        moves = Movements(
            row, copies["started_s"], ended_s, tick_s,
            copies["counts"], copies["ticks"], copies["velocity"],
            _ramps(copies) if len(copies) else np.zeros_like(copies["ticks"]),
        )  # fmt: skip
        return first, self._start_before(first), moves

    def movements(self, t: float) -> Movements:
        """Return every movement kept and begun until time t [s], which must not lie in the past."""
        self._robots.advance(t)
        self.observe()
        return self.since()[2]

    def motion(self, t: float, begin_s: float = 0.0) -> SegmentMotion | CurveMotion:
        """Return the motion of the arms of the plane until time t [s], without errors.

        Args:
            t: the end [s], not in the past.
            begin_s: time zero of the motion [s], before any movement.
        """
        moves = self.movements(t)
        return moves.motion(self._start, self.quantum_rad, t, begin_s)

    def arms(
        self, mechanics: Mechanics, state: ArmState, t: float, begin_s: float = 0.0
    ) -> tuple[SegmentMotion | CurveMotion, ArmState]:
        """Return the motion of the true arms until time t [s], and where they are then.

        Args:
            mechanics: the errors of the joints.
            state: the arms before the first movement that is kept.
            t: the end [s], not in the past.
            begin_s: time zero of the motion [s], before any movement.
        """
        counters = self.movements(t).counters(self._start, self.quantum_rad, t, begin_s)
        return arms_motion(mechanics, state, *counters)


class ObservedBuses:
    """A bus backend that observes the true motion after every batch.

    Args:
        backend: the backend that carries the messages.
        true_motion: the observer of the robots on it.
    """

    def __init__(self, backend: BusBackend, true_motion: TrueMotion):
        self._backend, self._true_motion = backend, true_motion

    def transfer(self, frames: Frames, read_bytes: ArrayLike, not_before_s: ArrayLike) -> Replies:
        """Carry a batch of messages and observe; see BusBackend.transfer."""
        replies = self._backend.transfer(frames, read_bytes, not_before_s)
        self._true_motion.observe()
        return replies

    def recover(self, bus: int, recovery: Recovery, t: float) -> tuple[float, bool]:
        """Try to free the lines of a bus; see BusBackend.recover."""
        return self._backend.recover(bus, recovery, t)

    def alert_lines(self, t: float) -> Ints:
        """Return the buses with a low alert line; see BusBackend.alert_lines."""
        return self._backend.alert_lines(t)
