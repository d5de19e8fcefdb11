# SPDX-License-Identifier: Apache-2.0
"""The motions that a robot can select from, straightest first."""

from dataclasses import replace

import numpy as np

from fiber_core import kinematics
from fiber_core.array_types import Counts, Floats, Ints, Mask, Rows
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion, SegmentMotion
from fiber_core.ragged import Parts
from fiber_core.threads import share_out
from fiber_core.wire_units import WireUnits
from fiber_discretizer.corridor import Corridors, Task, keep_inside, open_corridors
from fiber_discretizer.fit.linearize import Polylines, linearize
from fiber_discretizer.options import DiscretizeOptions
from fiber_discretizer.quantize import Rounding, quantize
from fiber_discretizer.sequential.segment_plan import SegmentPlan
from fiber_discretizer.soften import softened

__all__ = ["Candidates"]

_LEAST_ROBOTS = 8  # of a thread that traces corridors: fewer are done sooner than it begins
_INTERVALS = 24
_SHARES = np.linspace(0.0, 1.0, _INTERVALS + 1)
_FINEST_MM = 0.001  # smallest width within which a trajectory is traced
_PAD_RAD = 0.01  # kept from the bounds of a corridor, which hold at its samples only
_FREE_SLACK_RAD = 0.25  # how far rounding may shift a straight line
_FIBRE_MM = 0.4e-3  # end error of a joint where a plane says where its fibres are
_SPEED = 0.998  # part of the speed limit that paths may use; rounding takes from the rest


class Candidates:
    """The task of all robots of a plane, and the motions that they can select from.

    Args:
        plan: segments of all robots; gives units, outlines and neighbours.
        start: encoder counts at the start [quanta], shape (n, 2).
        trajectory: joint profiles of all its robots, from time zero.
        options: options of the discretizer.

    Attributes:
        start, goal: encoder counts at the start and at the end [quanta], shape (n, 2).
        moving_joints: number of joints of each robot that end elsewhere, shape (n,).
        moves: robots that move in the trajectory, to a goal or out of the way, shape (n,).
        time_s: sample times of the trajectory [s], shape (t,).
        arrival_s: when each joint comes to rest in the trajectory [s], shape (n, 2).
        fastest_s: shortest time that each joint needs [s], shape (n, 2).
    """

    def __init__(
        self,
        plan: SegmentPlan,
        start: Counts,
        trajectory: SampledMotion,
        options: DiscretizeOptions,
    ):
        plane, units = plan.plane, plan.units
        self._plan, self._options = plan, options
        self.time_s, self._planned = trajectory.time_s, trajectory.angles
        self._ranges = units.range_counts(plane)
        still = trajectory.angles == trajectory.angles[:, :, -1:]
        goal = np.clip(units.to_counts(trajectory.end), *np.moveaxis(self._ranges, -1, 0))
        self.start = start
        self.goal = np.where(still.all(axis=2), self.start, goal)
        self.moving_joints: Ints = (self.start != self.goal).sum(axis=1)
        self.moves: Mask = ~still.all(axis=(1, 2))
        last = still.shape[2] - np.argmin(still[:, :, ::-1], axis=2)
        last = np.where(still.all(axis=2), 0, np.minimum(last, still.shape[2] - 1))
        self.arrival_s = self.time_s[last]
        self._latest_s = self.arrival_s.max(initial=0.0)
        travel = np.abs(units.to_angles(self.goal - self.start))
        most = units.max_velocity * units.velocity_rad_s
        self._speeds = np.maximum(_SPEED * np.minimum(plane.speeds, most), 1e-9)
        self.fastest_s = travel / self._speeds
        self._rounding = _rounding_of(plane, units, options.rounding)

    def straight(self, rows: Rows, windows: Floats | None = None) -> SegmentMotion:
        """Return motions of one line for each joint, after a rest where its window begins late.

        Args:
            rows: the robots, shape (m,).
            windows: when each joint turns [s], shape (m, 2, 2): robot, joint, (begin, end); as
                in the trajectory by default.
        """
        windows = self.planned_windows(rows) if windows is None else windows
        lines = [self._line(rows, joint, windows[:, joint]) for joint in (0, 1)]
        return self._rounded(rows, lines, _FREE_SLACK_RAD)

    def bent(
        self,
        rows: Rows,
        motion: SegmentMotion,
        required_mm: Floats,
        joint: int,
        side: int,
        windows: Floats | None = None,
    ) -> tuple[SegmentMotion, Mask]:
        """Return motions with one joint straight and the other around what is in its way.

        Args:
            rows: the robots, shape (m,).
            motion: the motion of all other robots.
            required_mm: gap each pair must keep [mm], shape (p,).
            joint: the joint that bends, 0 theta or 1 phi.
            side: whether it passes at higher (+1) or at lower angles (-1).
            windows: as for straight.

        Returns:
            The motions, and which of the robots have one, shape (m,).
        """
        windows = self.planned_windows(rows) if windows is None else windows
        lines = [self._line(rows, j, windows[:, j]) for j in (0, 1)]
        times = windows[:, :, 1].max(axis=1)[:, None] * _SHARES
        desired = np.stack([line.at(times) for line in lines], axis=1)
        lines[joint], found = self._through(rows, motion, required_mm, joint, times, desired, side)
        return self._rounded(rows, lines), found

    def along_trajectory(
        self, rows: Rows, motion: SegmentMotion, required_mm: Floats, first_joint: int
    ) -> tuple[SegmentMotion, Mask]:
        """Return motions around the trajectory: in the corridor of one joint, then of the other.

        Args:
            rows: the robots, shape (m,).
            motion: the motion of all other robots.
            required_mm: gap each pair must keep [mm], shape (p,).
            first_joint: the joint that is fitted first.

        Returns:
            The motions, and which of the robots have one, shape (m,).
        """
        times = self.arrival_s[rows].max(axis=1)[:, None] * _SHARES
        desired = self._planned_at(rows, times)
        desired[:, :, 0] = self._plan.units.to_angles(self.start[rows])
        lines: dict[int, Polylines] = {}
        found = np.ones(len(rows), dtype=bool)
        for joint in (first_joint, 1 - first_joint):
            lines[joint], possible = self._through(
                rows, motion, required_mm, joint, times, desired, 0
            )
            found &= possible
            desired[:, joint] = lines[joint].at(times)
        return self._rounded(rows, [lines[0], lines[1]]), found

    def planned_lines(self, rows: Rows, width_mm: float) -> Polylines:
        """Return the trajectory as lines within a width [mm]; breaks are samples of it."""
        return self._trace(rows, width_mm)[0]

    def rounded(self, rows: Rows, lines: Polylines, slack_rad: float) -> SegmentMotion:
        """Return lines in whole units; rounding may shift a profile by a slack.

        Args:
            rows: the robots, shape (m,).
            lines: profiles of theta and phi of these in turn.
            slack_rad: largest shift [rad].
        """
        return self._quantized(rows, lines, np.full((len(rows), 2), slack_rad))

    def traced(self, rows: Rows, width_mm: float) -> SegmentMotion:
        """Return the trajectory itself, within a width [mm], not rounded."""
        paths = self._trace(rows, width_mm)[0]
        times, angles = (values[1:] - values[:-1] for values in (paths.time_s, paths.angles))
        lines = np.flatnonzero(paths.parts.owner[1:] == paths.parts.owner[:-1])
        offsets = Parts.from_counts(paths.counts).offsets
        return SegmentMotion(
            self._plan.motion.start[rows], offsets, times[lines], angles[lines] / times[lines]
        )

    def traced_rounded(self, rows: Rows, width_mm: float) -> SegmentMotion:
        """Return the trajectory itself, within a width [mm], in whole units."""
        return self._quantized(rows, *self._trace(rows, width_mm))

    def too_many_segments(self, rows: Rows) -> Rows:
        """Return those of some robots at rest that could move with more segments.

        Args:
            rows: the robots, shape (m,).
        """
        finest = self.traced_rounded(rows, _FINEST_MM)
        too_many = finest.counts.max(axis=1) > self._options.max_segments
        pairs = self._plan.pairs_of(rows)
        unsafe = self._plan.robots_in(pairs[self._plan.unproven(pairs, rows, finest)])
        return rows[too_many & ~unsafe[rows]]

    def planned_windows(self, rows: Rows) -> Floats:
        """Return when each joint turns in the trajectory [s], shape (m, 2, 2).

        Where one segment would be too long for its field, the joint ends sooner if it can.
        """
        longest = self._plan.units.max_ticks * self._plan.units.tick_s
        end = np.minimum(self.arrival_s[rows], np.maximum(longest, self.fastest_s[rows]))
        return np.stack([np.zeros_like(end), end], axis=-1)

    def _trace(self, rows: Rows, width_mm: float) -> tuple[Polylines, Floats]:
        # the trajectory as lines within a width, half for each joint, and that in angles
        profiles = self._planned[rows].reshape(2 * len(rows), len(self.time_s))
        width_rad = 0.5 * width_mm / self._plan.levers_mm[rows]
        low, high = profiles - width_rad.reshape(-1, 1), profiles + width_rad.reshape(-1, 1)
        return linearize(self.time_s, profiles, low, high, "greedy"), width_rad

    def _line(self, rows: Rows, joint: int, window: Floats) -> Polylines:
        # from start to goal in a window; a joint that rests has one knot
        ends = self._plan.units.to_angles(np.stack([self.start, self.goal], axis=-1)[rows, joint])
        moves = (self.start[rows, joint] != self.goal[rows, joint]) & (window[:, 1] > window[:, 0])
        keep = np.stack([np.ones_like(moves), moves], axis=1)
        offsets = Parts.from_counts(keep.sum(axis=1)).offsets
        return Polylines(offsets, window[keep], ends[keep])

    def _planned_at(self, rows: Rows, times: Floats) -> Floats:
        # planned angles of each robot at its own times, shape (m, 2, t)
        k = np.clip(np.searchsorted(self.time_s, times, side="right") - 1, 0, len(self.time_s) - 2)
        part = (times - self.time_s[k]) / (self.time_s[k + 1] - self.time_s[k])
        planned = self._planned[rows]
        before = np.take_along_axis(planned, k[:, None], axis=2)
        after = np.take_along_axis(planned, k[:, None] + 1, axis=2)
        return before + np.clip(part, 0.0, 1.0)[:, None] * (after - before)

    def _through(
        self,
        rows: Rows,
        motion: SegmentMotion,
        required_mm: Floats,
        joint: int,
        times: Floats,
        desired: Floats,
        side: int,
    ) -> tuple[Polylines, Mask]:
        # Lines through the corridor of one joint, and which of the robots have such lines. Each
        # robot has a corridor of its own, so the result does not depend on the threads.
        plan = self._plan
        parts: dict[int, tuple[Polylines, Mask]] = {}

        def find(first: int, last: int) -> None:
            part = slice(first, last)
            task = Task(
                plan.bodies.table, plan.levers_mm, plan.plane.limits, motion.arrays,
                plan.neighbours, required_mm, rows[part], joint, times[part], desired[part],
                self._options.reach_rad,
            )  # fmt: skip
            parts[first] = self._path(task, side)

        share_out(find, len(rows), _LEAST_ROBOTS)
        paths, found = zip(*(parts[first] for first in sorted(parts)))
        return Polylines.concatenate(paths), np.concatenate(found)

    def _path(self, task: Task, side: int) -> tuple[Polylines, Mask]:
        # Paths are fitted to the bounds that are known, and again where they cross another.
        corridors = open_corridors(task, side)
        found = corridors.is_open.copy()
        path = _straight(task.desired[:, task.joint])  # the caller drops those that are not found
        left = np.flatnonzero(found)
        while len(left):
            fitted = self._fit(task, corridors, left)
            possible = fitted.counts >= 0
            found[left[~possible]] = False
            left, fitted = left[possible], fitted.of(np.flatnonzero(possible))
            path = path.with_profiles(left, fitted)
            samples = fitted.at(np.tile(_SHARES, (len(left), 1)))
            before = corridors.bounds[:, left].copy()
            inside = keep_inside(task, corridors, left, samples, _PAD_RAD)
            # no fit changes where an end, which is given, lies beyond a bound
            changed = (corridors.bounds[:, left] != before).any(axis=(0, 2))
            found[left[~inside & ~changed]] = False
            left = left[~inside & changed]
        time_s = path.time_s * task.times[path.parts.owner, -1]
        return Polylines(path.offsets, time_s, path.angles), found

    def _fit(self, task: Task, corridors: Corridors, places: Ints) -> Polylines:
        # lines through the corridors at some places as far as they are known; no knots without
        rows, joint = task.rows[places], task.joint
        low, high = corridors.bounds[:, places]
        pad = np.minimum(_PAD_RAD, 0.25 * (high - low))
        low, high = low + pad, high - pad
        center = np.clip(task.desired[places, joint], low, high)
        center[:, 0], center[:, -1] = self._plan.units.to_angles(
            np.stack([self.start[rows, joint], self.goal[rows, joint]])
        )
        speed = self._speeds[rows, joint] * task.times[places, -1]
        last = np.full(len(places), _INTERVALS)
        return linearize(_SHARES, center, low, high, self._options.method, speed, last)

    def _rounded(
        self, rows: Rows, lines: list[Polylines], slack: float | None = None
    ) -> SegmentMotion:
        slack_rad = np.full((len(rows), 2), self._options.slack_rad if slack is None else slack)
        return self._quantized(rows, Polylines.of_joints(lines[0], lines[1]), slack_rad)

    def _quantized(self, rows: Rows, lines: Polylines, slack_rad: Floats) -> SegmentMotion:
        orders = quantize(
            lines,
            self.start[rows],
            self.goal[rows],
            self._ranges[rows],
            self._plan.plane.speeds[rows],
            slack_rad,
            self._plan.units,
            self._rounding,
            self._latest_s,
        )
        return softened(self._plan.plane.drive.of_robots(rows), orders).decoded()


def _rounding_of(plane: FocalPlane, units: WireUnits, rounding: Rounding) -> Rounding:
    # so fine that a fibre that is not just the tip ends within a micrometre, on arms of any length
    if not plane.fibres.shape[1]:
        return rounding
    reach_mm = kinematics.distance_range(plane.with_fibre(None))[1].max(initial=0.0)
    worst = max(1, int(_FIBRE_MM / max(reach_mm * units.quantum_rad, 1e-12)))
    good, worst = min(rounding.good_quanta, worst), min(rounding.worst_quanta, worst)
    return replace(rounding, good_quanta=good, worst_quanta=worst)


def _straight(samples: Floats) -> Polylines:
    # one line for each profile, from its first to its last sample
    ends = samples[:, [0, -1]]
    return Polylines(
        2 * np.arange(len(samples) + 1), np.tile([0.0, 1.0], len(samples)), ends.ravel()
    )
