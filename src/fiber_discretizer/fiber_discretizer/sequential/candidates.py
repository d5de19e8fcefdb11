"""Motions a robot can choose from when it is its turn, straightest first."""

import numpy as np

from fiber_core.clearance import Profiles
from fiber_core.motion import SampledMotion
from fiber_discretizer.corridor import free_corridors
from fiber_discretizer.fit.linearize import Polylines, linearize
from fiber_discretizer.options import DiscretizeOptions
from fiber_discretizer.quantize import quantize
from fiber_discretizer.segments import Segments
from fiber_discretizer.sequential.segment_plan import Draft

__all__ = ["Candidates"]

_INTERVALS = 48  # of the time grid of a tube
_SHARES = np.linspace(0.0, 1.0, _INTERVALS + 1)
_FINEST_MM = 0.001  # how closely the plan is followed at most
_PAD_RAD = 0.01  # kept from the walls of a tube: nothing is known between samples
_FREE_SLACK_RAD = 0.25  # how far rounding may shift a straight line
_SPEED = 0.998  # part of the speed limit that paths may use; rounding takes from the rest


class Candidates:
    """What is asked of all robots of a plane, and the motions they can choose from.

    Args:
        draft: of the plane; its units, its outlines, who is beside whom.
        trajectory: joint profiles of all its robots, from time zero.
        options: how it is done.

    Attributes:
        start, goal: where the motors are and are to end [quanta], shape (n, 2).
        motors: how many motors of a robot do not end where they are, shape (n,).
        moves: robots that have somewhere to go or, on their way, to make room, shape (n,).
        time_s: sample times of the trajectory [s], shape (t,).
        arrival_s: when each motor is to come to rest [s], shape (n, 2).
        fastest_s: how long it takes at least [s], shape (n, 2).
    """

    def __init__(self, draft: Draft, trajectory: SampledMotion, options: DiscretizeOptions):
        plane, units = draft.plane, draft.units
        self._draft, self._options = draft, options
        self.time_s, self._planned = trajectory.time_s, trajectory.angles
        self._ranges = units.range_counts(plane)
        still = trajectory.angles == trajectory.angles[:, :, -1:]
        goal = np.clip(units.to_counts(trajectory.end), *np.moveaxis(self._ranges, -1, 0))
        self.start = draft.start
        self.goal = np.where(still.all(axis=2), self.start, goal)
        self.motors = (self.start != self.goal).sum(axis=1)
        self.moves = ~still.all(axis=(1, 2))
        last = still.shape[2] - np.argmin(still[:, :, ::-1], axis=2)
        last = np.where(still.all(axis=2), 0, np.minimum(last, still.shape[2] - 1))
        self.arrival_s = self.time_s[last]
        self._latest_s = self.arrival_s.max(initial=0.0)
        travel = np.abs(units.to_angles(self.goal - self.start))
        most = units.max_velocity * units.velocity_rad_s
        self._speeds = np.maximum(_SPEED * np.minimum(plane.speeds, most), 1e-9)
        self.fastest_s = travel / self._speeds

    def straight(self, rows, windows=None) -> Segments:
        """Return motions of one line a motor, in two where it has to wait first.

        Args:
            rows: robots, shape (m,).
            windows: when each motor turns [s], shape (m, 2, 2): robot, joint, (begin, end); as
                planned by default.
        """
        windows = self.planned_windows(rows) if windows is None else windows
        lines = [self._line(rows, joint, windows[:, joint]) for joint in (0, 1)]
        return self._rounded(rows, lines, _FREE_SLACK_RAD)

    def bent(self, rows, profiles: Profiles, required_mm, joint: int, side: int, windows=None):
        """Return motions with one motor straight and the other around what is in its way.

        Args:
            rows: robots, shape (m,).
            profiles: the motion of everybody else, from profiles_of.
            required_mm: gap each pair must keep [mm], shape (p,).
            joint: the motor that bends, 0 theta or 1 phi.
            side: whether it passes at higher (+1) or at lower angles (-1).
            windows: as for straight.

        Returns:
            Segments of 2 m profiles, and which of the robots have such a motion, shape (m,).
        """
        windows = self.planned_windows(rows) if windows is None else windows
        lines = [self._line(rows, j, windows[:, j]) for j in (0, 1)]
        times = windows[:, :, 1].max(axis=1)[:, None] * _SHARES
        wish = np.stack([line.at(times) for line in lines], axis=1)
        walls = self._walls(rows, profiles, required_mm, joint, times, wish, side)
        lines[joint], found = self._path(rows, joint, times, wish, walls)
        return self._rounded(rows, lines), found

    def along_plan(self, rows, profiles: Profiles, required_mm, first_joint: int):
        """Return motions along the plan: the tube of one motor, then that of the other.

        Args:
            rows: robots, shape (m,).
            profiles: the motion of everybody else, from profiles_of.
            required_mm: gap each pair must keep [mm], shape (p,).
            first_joint: the motor done first.

        Returns:
            As bent.
        """
        times = self.arrival_s[rows].max(axis=1)[:, None] * _SHARES
        wish = self._plan_at(rows, times)
        wish[:, :, 0] = self._draft.units.to_angles(self.start[rows])
        lines, found = [None, None], np.ones(len(rows), dtype=bool)
        for joint in (first_joint, 1 - first_joint):
            walls = self._walls(rows, profiles, required_mm, joint, times, wish, 0)
            lines[joint], possible = self._path(rows, joint, times, wish, walls)
            found &= possible
            wish[:, joint] = lines[joint].at(times)
        return self._rounded(rows, lines), found

    def planned(self, rows, width_mm: float) -> Segments:
        """Return the plan itself, followed so closely [mm], nothing rounded."""
        return Segments.along(self._along(rows, width_mm)[0], self._draft.units)

    def rounded_plan(self, rows, width_mm: float) -> Segments:
        """Return the plan, followed so closely [mm], in whole units."""
        lines, width_rad = self._along(rows, width_mm)
        joints = np.tile([0, 1], len(rows))
        return self._quantized(lines, np.repeat(rows, 2), joints, width_rad)

    def too_many_segments(self, rows) -> np.ndarray:
        """Return which of some robots, shape (m,), at rest could go with more segments."""
        finest = self.rounded_plan(rows, _FINEST_MM)
        crowded = finest.counts.reshape(-1, 2).max(axis=1) > self._options.max_segments
        pairs = self._draft.pairs_of(rows)
        unsafe = self._draft.robots_in(pairs[self._draft.unproven(pairs, rows, finest)])
        return rows[crowded & ~unsafe[rows]]

    def _along(self, rows, width_mm):
        # the plan as lines within a width, half of it for each motor, and that in angles
        profiles = self._planned[rows].reshape(2 * len(rows), len(self.time_s))
        width_rad = 0.5 * width_mm / self._draft.levers_mm[rows].ravel()
        low, high = profiles - width_rad[:, None], profiles + width_rad[:, None]
        return linearize(self.time_s, profiles, low, high, "greedy"), width_rad

    def planned_windows(self, rows) -> np.ndarray:
        """Return when each motor turns as planned [s], shape (m, 2, 2).

        Where one segment would be too long for its field, the motor ends sooner if it can.
        """
        longest = self._draft.units.max_ticks * self._draft.units.tick_s
        end = np.minimum(self.arrival_s[rows], np.maximum(longest, self.fastest_s[rows]))
        return np.stack([np.zeros_like(end), end], axis=-1)

    def _line(self, rows, joint, window):
        # from start to goal in a window; a motor that stays has one knot
        ends = self._draft.units.to_angles(np.stack([self.start, self.goal], axis=-1)[rows, joint])
        moves = (self.start[rows, joint] != self.goal[rows, joint]) & (window[:, 1] > window[:, 0])
        keep = np.stack([np.ones_like(moves), moves], axis=1)
        offsets = np.concatenate([[0], np.cumsum(keep.sum(axis=1))])
        return Polylines(offsets, window[keep], ends[keep])

    def _plan_at(self, rows, times):
        # planned angles of each robot at its own times, shape (m, 2, t)
        k = np.clip(np.searchsorted(self.time_s, times, side="right") - 1, 0, len(self.time_s) - 2)
        part = (times - self.time_s[k]) / (self.time_s[k + 1] - self.time_s[k])
        mine = self._planned[rows]
        here = np.take_along_axis(mine, k[:, None], axis=2)
        there = np.take_along_axis(mine, k[:, None] + 1, axis=2)
        return here + np.clip(part, 0.0, 1.0)[:, None] * (there - here)

    def _walls(self, rows, profiles, required_mm, joint, times, wish, side):
        draft = self._draft
        return free_corridors(
            draft.bodies.table, self._draft.levers_mm, draft.plane.limits, profiles, draft.beside,
            required_mm, rows, joint, times, wish, side, self._options.reach_rad,
        )  # fmt: skip

    def _path(self, rows, joint, times, wish, walls):
        low, high, found = walls
        lasting = times[:, -1]
        speed = self._speeds[rows, joint] * lasting
        pad = np.minimum(_PAD_RAD, 0.25 * (high - low))
        low, high = low + pad, high - pad
        wish = np.clip(wish[:, joint], low, high)
        wish[:, 0], wish[:, -1] = self._draft.units.to_angles(
            np.stack([self.start[rows, joint], self.goal[rows, joint]])
        )
        last = np.full(len(rows), _INTERVALS)
        path = linearize(_SHARES, wish, low, high, self._options.method, speed, last)
        found = found & (path.counts >= 0)
        if not found.all():  # a robot without a path gets one that is thrown away
            straight = linearize(_SHARES, wish, -np.inf, np.inf, "minimal", np.inf, last)
            path = _chosen(found, path, straight)
        row = np.repeat(np.arange(len(rows)), np.diff(path.offsets))
        return Polylines(path.offsets, path.time_s * lasting[row], path.angles), found

    def _rounded(self, rows, lines, slack=None):
        slack = self._options.slack_rad if slack is None else slack
        done = Segments.none(2 * len(rows))
        for joint in (0, 1):
            one = self._quantized(lines[joint], rows, np.full(len(rows), joint), slack)
            done = done.replaced(2 * np.arange(len(rows)) + joint, one)
        return done

    def _quantized(self, lines, rows, joints, slack):
        return quantize(
            lines,
            self.start[rows, joints],
            self.goal[rows, joints],
            self._ranges[rows, joints],
            self._draft.plane.speeds[rows, joints],
            np.broadcast_to(slack, len(rows)),
            self._draft.units,
            self._options.rounding,
            self._latest_s,
        )


def _chosen(first, one: Polylines, other: Polylines) -> Polylines:
    # the paths of one where `first`, else those of the other
    counts = np.where(first, np.diff(one.offsets), np.diff(other.offsets))
    begin = np.where(first, one.offsets[:-1], other.offsets[:-1] + len(one.time_s))
    offsets = np.concatenate([[0], np.cumsum(counts)])
    pick = np.arange(offsets[-1]) + np.repeat(begin - offsets[:-1], counts)
    times = np.concatenate([one.time_s, other.time_s])[pick]
    return Polylines(offsets, times, np.concatenate([one.angles, other.angles])[pick])
