"""True motion of the simulated robots, for judges that must not believe the robots' reports."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.bus import BusBackend, Recovery, Replies
from fiber_bus_bridge.simulation.memory import Memory
from fiber_bus_bridge.simulation.positioners import Positioners
from fiber_bus_bridge.wire import Frames
from fiber_core.array_types import Floats, Ints, Rows
from fiber_core.motion import SegmentMotion
from fiber_core.ragged import Parts

__all__ = ["Movements", "ObservedBuses", "TrueMotion"]


class Movements(NamedTuple):
    """Movements of robots, one row each, in the order in which they were observed.

    Args:
        row: the robot, shape (r,).
        started_s: start [s], shape (r,).
        ended_s: end, completed or broken off [s], nan while the robot moves, shape (r,).
        counts: numbers of segments of theta and phi, shape (r, 2).
        ticks: durations [ticks], shape (r, 2, MAX_SEGMENTS).
        velocity: speeds [velocity units], shape (r, 2, MAX_SEGMENTS).
    """

    row: Rows
    started_s: Floats
    ended_s: Floats
    counts: Ints
    ticks: Ints
    velocity: Ints


class TrueMotion:
    """The true motion of all robots, observed from now on.

    `observe` must be called after every call that can start a robot, before another call can
    start the robot again: once for each batch of frames is enough.

    Args:
        robots: the robots, all at rest.
        quantum_rad: size of one encoder count [rad].
    """

    def __init__(self, robots: Positioners, quantum_rad: float):
        self._robots, self._quantum_rad = robots, quantum_rad
        self._start = robots.memory["position"].copy()
        self._last_started_s = robots.memory["started_s"].copy()
        self._open = np.full(robots.n, -1)  # movement of each robot that has not ended
        self._go_s = np.full(robots.n, np.inf)
        self._rows: list[int] = []
        self._ended: list[float] = []
        self._copies: list[Memory] = []

    def observe(self) -> None:
        """Record the robots that have started or stopped since the last call."""
        memory = self._robots.memory
        self._close_ended()
        for row in np.flatnonzero(memory["started_s"] != self._last_started_s):
            self._last_started_s[row] = memory["started_s"][row]
            self._go_s[row] = memory["heartbeat_s"][row]
            self._open[row] = len(self._rows)
            self._rows.append(int(row))
            self._ended.append(np.nan)
            self._copies.append(memory[row].copy())
        self._close_ended()

    def _close_ended(self) -> None:
        # a movement broken off in its countdown ended before it began, but after the GO
        halted_s = self._robots.memory["halted_s"]
        for row in np.flatnonzero((self._open >= 0) & (halted_s > self._go_s)):
            self._ended[self._open[row]] = halted_s[row]
            self._open[row] = -1

    def movements(self, t: float) -> Movements:
        """Return every movement begun until time t [s], which must not lie in the past."""
        self._robots.advance(t)
        self.observe()
        copies = np.array(self._copies, dtype=self._robots.memory.dtype)
        row = np.array(self._rows, dtype=np.int64)
        names = ("started_s", "counts", "ticks", "velocity")
        started_s, counts, ticks, velocity = (copies[name] for name in names)
        return Movements(row, started_s, np.array(self._ended), counts, ticks, velocity)

    def motion(self, t: float, begin_s: float = 0.0) -> SegmentMotion:
        """Return the motion of the plane until time t [s].

        Args:
            t: the end [s], not in the past.
            begin_s: time zero of the motion [s], before any movement.
        """
        moves = self.movements(t)
        memory, n = self._robots.memory, self._robots.n
        durations: list[list[float]] = [[] for _ in range(2 * n)]
        speeds: list[list[float]] = [[] for _ in range(2 * n)]
        now = np.full(n, begin_s)
        for k, row in enumerate(moves.row):
            until = t if np.isnan(moves.ended_s[k]) else moves.ended_s[k]
            if until <= moves.started_s[k]:
                continue
            tick_s = self._copies[k]["tick_us"] / (1e6 + memory["clock_ppm"][row])
            for joint in range(2):
                count = moves.counts[k, joint]
                lasts = moves.ticks[k, joint, :count] * tick_s
                ends = np.minimum(np.cumsum(lasts), until - moves.started_s[k])
                lasts = np.diff(ends, prepend=0.0)
                rest = until - moves.started_s[k] - lasts.sum()
                pieces = [(moves.started_s[k] - now[row], 0.0)]
                speed = moves.velocity[k, joint, :count] * self._quantum_rad / tick_s
                pieces += [*zip(lasts, speed), (rest, 0.0)]
                for duration, velocity in pieces:
                    if duration > 0.0:
                        durations[2 * row + joint].append(duration)
                        speeds[2 * row + joint].append(velocity)
            now[row] = until
        offsets = Parts.from_counts([len(d) for d in durations]).offsets
        flat = [np.array([x for part in parts for x in part]) for parts in (durations, speeds)]
        return SegmentMotion(self._start * self._quantum_rad, offsets, *flat)


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
