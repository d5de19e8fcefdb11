"""How simulated robots really moved, for judges that must not believe what robots report."""

from typing import NamedTuple

import numpy as np

from fiber_bus_bridge.simulation.positioners import Positioners
from fiber_core.motion import SegmentMotion

__all__ = ["TrueMotion", "Runs"]


class Runs(NamedTuple):
    """Motions that robots began, one row each, in the order they were noticed.

    Args:
        row: the robot, shape (r,).
        started_s: when it began [s], shape (r,).
        ended_s: when it ended or was broken off [s], nan while it goes on, shape (r,).
        counts: segments of theta and phi, shape (r, 2).
        ticks: durations [ticks], shape (r, 2, MAX_SEGMENTS).
        velocity: speeds [velocity units], shape (r, 2, MAX_SEGMENTS).
    """

    row: np.ndarray
    started_s: np.ndarray
    ended_s: np.ndarray
    counts: np.ndarray
    ticks: np.ndarray
    velocity: np.ndarray


class TrueMotion:
    """The true motion of all robots since the record was made.

    `look` must be called after every call that can start a robot, before any other can
    start it again: once a batch of frames is often enough.

    Args:
        robots: the robots, all at rest.
        quantum_rad: what one of their encoder counts is [rad].
    """

    def __init__(self, robots: Positioners, quantum_rad: float):
        self._robots, self._quantum_rad = robots, quantum_rad
        self._start = robots.memory["position"].copy()
        self._seen = robots.memory["started_s"].copy()
        self._open = np.full(robots.n, -1)
        self._go_s = np.full(robots.n, np.inf)
        self._rows: list[int] = []
        self._ended: list[float] = []
        self._copies: list[np.ndarray] = []

    def look(self) -> None:
        """Note who began to move since the last look."""
        memory = self._robots.memory
        self._close()
        for row in np.flatnonzero(memory["started_s"] != self._seen):
            self._seen[row] = memory["started_s"][row]
            self._go_s[row] = memory["beat_s"][row]
            self._open[row] = len(self._rows)
            self._rows.append(int(row))
            self._ended.append(np.nan)
            self._copies.append(memory[row].copy())
        self._close()

    def _close(self):
        # a motion broken off in its countdown ended before it began, but after the GO
        halted_s = self._robots.memory["halted_s"]
        for row in np.flatnonzero((self._open >= 0) & (halted_s > self._go_s)):
            self._ended[self._open[row]] = halted_s[row]
            self._open[row] = -1

    def runs(self, t: float) -> Runs:
        """Return every motion begun until time t [s], which must not lie in the past."""
        self._robots.bring_up(t)
        self.look()
        copies = np.array(self._copies, dtype=self._robots.memory.dtype)
        row = np.array(self._rows, dtype=np.int64)
        names = ("started_s", "counts", "ticks", "velocity")
        started_s, *order = (copies[name] for name in names)
        return Runs(row, started_s, np.array(self._ended), *order)

    def motion(self, t: float, begin_s: float = 0.0) -> SegmentMotion:
        """Return the motion of the whole plane from begin_s, before any, until time t [s]."""
        runs = self.runs(t)
        memory, n = self._robots.memory, self._robots.n
        durations, speeds = [[] for _ in range(2 * n)], [[] for _ in range(2 * n)]
        now = np.full(n, begin_s)
        for k, row in enumerate(runs.row):
            until = t if np.isnan(runs.ended_s[k]) else runs.ended_s[k]
            if until <= runs.started_s[k]:
                continue
            tick_s = self._copies[k]["tick_us"] / (1e6 + memory["clock_ppm"][row])
            for joint in range(2):
                count = runs.counts[k, joint]
                lasts = runs.ticks[k, joint, :count] * tick_s
                ends = np.minimum(np.cumsum(lasts), until - runs.started_s[k])
                lasts = np.diff(ends, prepend=0.0)
                rest = until - runs.started_s[k] - lasts.sum()
                pieces = [(runs.started_s[k] - now[row], 0.0)]
                speed = runs.velocity[k, joint, :count] * self._quantum_rad / tick_s
                pieces += [*zip(lasts, speed), (rest, 0.0)]
                for lasting, turn in pieces:
                    if lasting > 0.0:
                        durations[2 * row + joint].append(lasting)
                        speeds[2 * row + joint].append(turn)
            now[row] = until
        offsets = np.concatenate([[0], np.cumsum([len(d) for d in durations])])
        flat = [np.array([x for part in parts for x in part]) for parts in (durations, speeds)]
        return SegmentMotion(self._start * self._quantum_rad, offsets, *flat)
