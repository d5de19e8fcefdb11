"""The seven steps of the paper: two neighbours have half of the space between them each.

Makarem et al. 2014 (SPIE, arXiv 1410.1181) as it is understood here: planned trajectory;
margin of the first motor; its profile linearized; margin of the second motor from the first
motor's new profile; its profile linearized; both in wire units; checked. Added: robots whose
trajectories meet are held first, and those whose decoded motion cannot be certified are done
again with tighter margins, then held.
"""

from collections.abc import Callable

import numpy as np

from fiber_core.clearance import Safety, certify, neighbour_pairs
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion, SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer.fit.linearize import linearize
from fiber_discretizer.makarem2014.free_space import FreeSpace
from fiber_discretizer.makarem2014.hold_on_samples import hold_on_samples
from fiber_discretizer.makarem2014.margin import joint_margins, tip_distances_mm
from fiber_discretizer.options import DiscretizeOptions
from fiber_discretizer.quantize import quantize
from fiber_discretizer.segments import Segments
from fiber_discretizer.validate import peak_speeds

__all__ = ["share_by_halves"]

_CAP_RAD = np.pi  # margin of a joint nobody is near
_MOST_SLACK_RAD = 0.1  # what it may shift the profile of a robot nobody is near
_LEAST_SLACK_RAD = 1e-3  # 6 um at a 6 mm arm: what rounding may always shift a profile by


def share_by_halves(
    plane: FocalPlane,
    trajectory: SampledMotion,
    start_counts: np.ndarray,
    units: WireUnits,
    safety: Safety,
    options: DiscretizeOptions,
    reason: np.ndarray,
    progress: Callable[[float, str], None],
) -> tuple[WireMotion, int]:
    """Return orders of all robots, and how often some of them were done again.

    Args:
        plane, trajectory, start_counts, units, safety, options, progress: as for discretize.
        reason: Reason of each robot, shape (n,); written where robots are given up.
    """
    halves = _Halves(plane, trajectory, start_counts, units, safety, options)

    def give_up(robots, why):
        reason[robots] = why
        halves.rest(robots)

    halves.rest(reason != Reason.OK)
    progress(0.1, "holding robots whose trajectories meet")
    give_up(hold_on_samples(halves.free_space), Reason.UNSAFE)
    todo = halves.moving
    tightness = np.ones(plane.n)
    rounds = 0
    while todo.any():
        progress(0.2 + 0.6 * rounds / (options.rounds + 1), f"discretizing {todo.sum()} robots")
        give_up(halves.redo(todo, tightness), Reason.TOO_MANY_SEGMENTS)
        todo = halves.unsafe(todo) & halves.moving
        if rounds == options.rounds or not todo.any():
            break
        rounds += 1
        tightness[todo] *= 0.5 if rounds < options.rounds else 0.0
    return halves.wire, rounds


class _Halves:
    """Segments of every motor so far. A new draft has none: everybody rests.

    Args:
        plane: the focal plane.
        trajectory: joint profiles of all its robots.
        start_counts: where the robots are [quanta], shape (n, 2).
        units: size of tick and quantum, and the widths of the fields.
        safety: gap asked for and timing errors to survive.
        options: how it is done.

    Attributes:
        free_space: free space along what each robot is to do so far: its orders where it
            has some, else its trajectory.
    """

    def __init__(
        self,
        plane: FocalPlane,
        trajectory: SampledMotion,
        start_counts: np.ndarray,
        units: WireUnits,
        safety: Safety,
        options: DiscretizeOptions,
    ):
        self.plane, self.units, self.safety, self.options = plane, units, safety, options
        self._time_s, self._planned = trajectory.time_s, trajectory.angles.copy()
        self._start, self._ranges = start_counts, units.range_counts(plane)
        self._segments = Segments.none(2 * plane.n)
        pairs, required_mm = _requirements(plane, trajectory, safety)
        self.free_space = FreeSpace(plane, pairs, required_mm, self._planned)

    @property
    def moving(self) -> np.ndarray:
        """Robots that are to move, shape (n,)."""
        return np.any(self._planned != self._planned[:, :, :1], axis=(1, 2))

    @property
    def wire(self) -> WireMotion:
        """The orders so far."""
        drawn = self._segments
        return WireMotion(self.units, self._start, drawn.offsets, drawn.ticks, drawn.velocity)

    def rest(self, robots: np.ndarray) -> None:
        """Let the robots, bool of shape (n,), stay where they are."""
        here = self.units.to_angles(self._start[robots])[:, :, None]
        self._planned[robots] = here
        self.free_space.move(robots, here)
        self._segments = self._segments.without(np.flatnonzero(np.repeat(robots, 2)))

    def redo(self, robots: np.ndarray, tightness: np.ndarray) -> np.ndarray:
        """Make the orders of some robots anew, beside the others as they are.

        Args:
            robots: whose, bool, shape (n,).
            tightness: part of its margin each robot may use, 0..1, shape (n,).

        Returns:
            Those of them that need more segments than an order carries, shape (n,).
        """
        options = self.options
        angles = self._planned[robots]
        self.free_space.move(robots, angles)
        paths, slack = [None, None], [None, None]
        for joint in (options.first_joint, 1 - options.first_joint):
            margins = tightness[robots, None] * self._margins(joint, robots)
            slack[joint] = np.clip(margins.min(axis=1), _LEAST_SLACK_RAD, _MOST_SLACK_RAD)
            low, high = angles[:, joint] - margins, angles[:, joint] + margins
            paths[joint] = linearize(self._time_s, angles[:, joint], low, high, options.method)
            angles[:, joint] = paths[joint](self._time_s)
            self.free_space.move(robots, angles)
        for joint in (0, 1):
            rows = np.flatnonzero(robots)
            drawn = self._rounded(rows, joint, paths[joint], slack[joint])
            self._segments = self._segments.replaced(2 * rows + joint, drawn)
            start = self._start[robots, joint]
            angles[:, joint] = drawn.polylines(start, self.units)(self._time_s)
        self.free_space.move(robots, angles)
        crowded = self._segments.counts.reshape(-1, 2).max(axis=1) > options.max_segments
        return robots & crowded

    def unsafe(self, robots: np.ndarray) -> np.ndarray:
        """Return who is in a pair with one of `robots` (bool, (n,)) that cannot be certified."""
        pairs = self.free_space.pairs[self.free_space.touching(robots)]
        return certify(self.plane, self.wire.decoded(), self.safety, pairs).unsafe_robots

    def _margins(self, joint, robots):
        concerned = self.free_space.touching(robots)
        pairs, angles = self.free_space.pairs[concerned], self.free_space.angles
        if self.options.rule == "safe":
            free = self.free_space.space_mm(concerned)
        else:
            free = tip_distances_mm(self.plane, pairs, angles)
        return joint_margins(self.plane, joint, pairs, free, angles[:, 1], robots, _CAP_RAD)

    def _rounded(self, rows, joint, paths, slack):
        ranges = self._ranges[rows, joint]
        goal = self.units.to_counts(self._planned[rows, joint, -1])
        return quantize(
            paths,
            self._start[rows, joint],
            np.clip(goal, ranges[:, 0], ranges[:, 1]),
            ranges,
            self.plane.speeds[rows, joint],
            slack,
            self.units,
            self.options.rounding,
        )


def _requirements(plane, trajectory, safety):
    # pairs and their gaps for a motion as fast and as long as the trajectory
    fastest = np.minimum(peak_speeds(trajectory), plane.speeds)
    makespan = trajectory.time_s[-1]
    if makespan == 0.0:
        motion = SegmentMotion.at_rest(trajectory.start)
    else:
        lasting = np.full(2 * plane.n, makespan)
        offsets = np.arange(2 * plane.n + 1)
        motion = SegmentMotion(trajectory.start, offsets, lasting, fastest.ravel())
    with_itself = np.repeat(np.arange(plane.n)[:, None], 2, axis=1)
    most = safety.required_mm(plane, motion, with_itself).max(initial=0.0)
    pairs = neighbour_pairs(plane, max(1.0, most))
    return pairs, safety.required_mm(plane, motion, pairs)
