# SPDX-License-Identifier: Apache-2.0
"""The seven steps of the paper: each of two neighbours has half of the space between them.

Makarem et al. 2014 (SPIE, arXiv 1410.1181) as it is understood here: planned trajectory;
share of the first joint; its profile fitted by lines; share of the second joint with the new
profile of the first; its profile fitted by lines; both in wire units; checked. Added: robots
with trajectories that meet are held first, and robots with a decoded motion that cannot be
certified are tried again with smaller shares, then held.
"""

import numpy as np

from fiber_core.array_types import Bools, Codes, Counts, Floats, Mask, Pairs, Rows
from fiber_core.clearance import Safety, certify, neighbour_pairs
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion, SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer.fit.linearize import Polylines, linearize, polylines_of
from fiber_discretizer.makarem2014.free_space import FreeSpace
from fiber_discretizer.makarem2014.hold_on_samples import hold_on_samples
from fiber_discretizer.makarem2014.share import joint_shares, tip_distances_mm
from fiber_discretizer.options import DiscretizeOptions, ProgressCallback
from fiber_discretizer.quantize import quantize
from fiber_discretizer.validate import peak_speeds

__all__ = ["discretize_makarem2014"]

_CAP_RAD = np.pi  # share of a joint without neighbours
_MOST_SLACK_RAD = 0.1  # how far rounding may shift the profile of a robot without neighbours
_LEAST_SLACK_RAD = 1e-3  # how far rounding may always shift a profile: 6 um at a 6 mm arm


def discretize_makarem2014(
    plane: FocalPlane,
    trajectory: SampledMotion,
    start_counts: Counts,
    units: WireUnits,
    safety: Safety,
    options: DiscretizeOptions,
    reason: Codes,
    progress: ProgressCallback,
) -> tuple[WireMotion, Codes, int]:
    """Return the orders of all robots by the seven steps of the paper.

    Args:
        plane, trajectory, start_counts, units, safety, options, progress: as for discretize.
        reason: Reason of each robot so far, shape (n,); a robot with another than OK rests.

    Returns:
        The orders; the Reason of each robot, with those held here, shape (n,); and how often
        some robots were tried again.
    """
    reason = reason.copy()
    steps = _SevenSteps(plane, trajectory, start_counts, units, safety, options)

    def hold(robots: Mask, why: Reason) -> None:
        reason[robots] = why
        steps.rest(robots)

    steps.rest(reason != Reason.OK)
    progress(0.1, "holding robots with trajectories that meet")
    hold(hold_on_samples(steps.free_space), Reason.UNSAFE)
    remaining = steps.moving
    part = np.ones(plane.n)
    rounds = 0
    while remaining.any():
        done = rounds / (options.rounds + 1)
        progress(0.2 + 0.6 * done, f"discretizing {remaining.sum()} robots")
        hold(steps.discretize(remaining, part), Reason.TOO_MANY_SEGMENTS)
        remaining = steps.unsafe(remaining) & steps.moving
        if rounds == options.rounds or not remaining.any():
            break
        rounds += 1
        part[remaining] *= 0.5 if rounds < options.rounds else 0.0
    return steps.wire, reason, rounds


class _SevenSteps:
    """The orders of all robots so far; at first all rest.

    Args:
        plane: the focal plane.
        trajectory: joint profiles of all its robots.
        start_counts: encoder counts at the start [quanta], shape (n, 2).
        units: size of tick and quantum, and the widths of the fields.
        safety: gap asked for and timing errors to survive.
        options: options of the discretizer.

    Attributes:
        wire: the orders so far.
        free_space: free space along the present motion of each robot: its segments where it
            has some, else its trajectory.
    """

    def __init__(
        self,
        plane: FocalPlane,
        trajectory: SampledMotion,
        start_counts: Counts,
        units: WireUnits,
        safety: Safety,
        options: DiscretizeOptions,
    ):
        self.plane, self.units, self.safety, self.options = plane, units, safety, options
        self._time_s, self._planned = trajectory.time_s, trajectory.angles.copy()
        self._start, self._ranges = start_counts, units.range_counts(plane)
        self.wire = WireMotion.at_rest(units, start_counts)
        pairs, required_mm = _requirements(plane, trajectory, safety)
        self.free_space = FreeSpace(plane, pairs, required_mm, self._planned)

    @property
    def moving(self) -> Mask:
        """Robots that are to move, shape (n,)."""
        return np.any(self._planned != self._planned[:, :, :1], axis=(1, 2))

    def rest(self, robots: Mask) -> None:
        """Let some robots, shape (n,), stay where they are."""
        start = self.units.to_angles(self._start[robots])[:, :, None]
        self._planned[robots] = start
        self.free_space.move(robots, start)
        self.wire = self.wire.without(robots)

    def discretize(self, robots: Mask, part: Floats) -> Mask:
        """Replace the segments of some robots, all others as they are.

        Args:
            robots: the robots, shape (n,).
            part: part of its share that each robot may use, 0..1, shape (n,).

        Returns:
            Those of the robots that need more segments than an order carries, shape (n,).
        """
        options, rows = self.options, np.flatnonzero(robots)
        angles = self._planned[robots]
        self.free_space.move(robots, angles)
        paths: dict[int, Polylines] = {}
        slack = np.empty((len(rows), 2))
        for joint in (options.first_joint, 1 - options.first_joint):
            shares = part[robots, None] * self._shares(joint, robots)
            slack[:, joint] = np.clip(shares.min(axis=1), _LEAST_SLACK_RAD, _MOST_SLACK_RAD)
            low, high = angles[:, joint] - shares, angles[:, joint] + shares
            paths[joint] = linearize(self._time_s, angles[:, joint], low, high, options.method)
            angles[:, joint] = paths[joint](self._time_s)
            self.free_space.move(robots, angles)
        rounded = self._rounded(rows, Polylines.of_joints(paths[0], paths[1]), slack)
        self.wire = self.wire.with_robots(rows, rounded)
        self.free_space.move(robots, polylines_of(rounded)(self._time_s).reshape(angles.shape))
        return robots & (self.wire.counts.max(axis=1) > options.max_segments)

    def unsafe(self, robots: Mask) -> Mask:
        """Return the robots of pairs with one of `robots` that cannot be certified, shape (n,)."""
        pairs = self.free_space.pairs[self.free_space.pairs_with(robots)]
        return certify(self.plane, self.wire.decoded(), self.safety, pairs).unsafe_robots

    def _shares(self, joint: int, robots: Mask) -> Floats:
        affected: Bools = self.free_space.pairs_with(robots)
        pairs, angles = self.free_space.pairs[affected], self.free_space.angles
        if self.options.rule == "safe":
            free = self.free_space.space_mm(affected)
        else:
            free = tip_distances_mm(self.plane, pairs, angles)
        return joint_shares(self.plane, joint, pairs, free, angles[:, 1], robots, _CAP_RAD)

    def _rounded(self, rows: Rows, paths: Polylines, slack: Floats) -> WireMotion:
        ranges = self._ranges[rows]
        goal = self.units.to_counts(self._planned[rows, :, -1])
        return quantize(
            paths,
            self._start[rows],
            np.clip(goal, ranges[..., 0], ranges[..., 1]),
            ranges,
            self.plane.speeds[rows],
            slack,
            self.units,
            self.options.rounding,
        )


def _requirements(
    plane: FocalPlane, trajectory: SampledMotion, safety: Safety
) -> tuple[Pairs, Floats]:
    # pairs and their required gaps for a motion as fast and as long as the trajectory
    fastest = np.minimum(peak_speeds(trajectory), plane.speeds)
    makespan = trajectory.time_s[-1]
    if makespan == 0.0:
        motion = SegmentMotion.at_rest(trajectory.start)
    else:
        durations = np.full(2 * plane.n, makespan)
        offsets = np.arange(2 * plane.n + 1)
        motion = SegmentMotion(trajectory.start, offsets, durations, fastest.ravel())
    with_itself = np.repeat(np.arange(plane.n)[:, None], 2, axis=1)
    most = safety.anywhere(plane).required_mm(plane, motion, with_itself).max(initial=0.0)
    pairs = neighbour_pairs(plane, max(1.0, most))
    return pairs, safety.required_mm(plane, motion, pairs)
