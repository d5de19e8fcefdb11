"""From a planned trajectory to certified orders: the whole way, in the order of the paper."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fiber_core.clearance import Certificate, Safety, hold_until_safe
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer.makarem2014.halves import share_by_halves
from fiber_discretizer.options import DiscretizeOptions
from fiber_discretizer.sequential.candidates import Candidates
from fiber_discretizer.sequential.segment_plan import Draft
from fiber_discretizer.sequential.sequential import take_turns
from fiber_discretizer.validate import check_trajectory, starting_counts

__all__ = ["Discretization", "discretize"]

_LATER_TICKS = 20  # how much longer than planned rounding makes a motion


@dataclass(frozen=True, eq=False)
class Discretization:
    """What is sent, and the proof that it is safe.

    Args:
        wire: the motion in whole wire units; robots with a reason other than OK rest.
        reason: Reason of each robot, shape (n,): OK, BAD_TRAJECTORY, DISABLED,
            TOO_MANY_SEGMENTS or UNSAFE.
        certificate: certificate of wire.decoded() over the whole plane. It is not ok
            only where robots at rest are too close already.
        rounds: how often margins were tightened.
    """

    wire: WireMotion
    reason: np.ndarray
    certificate: Certificate
    rounds: int


def discretize(
    plane: FocalPlane,
    trajectory: SampledMotion,
    units: WireUnits,
    safety: Safety,
    start_counts=None,
    options: DiscretizeOptions | None = None,
    progress: Callable[[float, str], None] | None = None,
    velocities=None,
) -> Discretization:
    """Turn a planned trajectory into few constant-velocity segments that are proven safe.

    Between its points a trajectory is straight. Robots whose profiles cannot be used rest;
    the others get the fewest segments found under the sharing of space that is asked for,
    rounded to whole units, and whoever cannot be certified on these rests with the reason.

    Args:
        plane: the focal plane.
        trajectory: joint profiles of all its robots.
        units: size of tick and quantum, and the widths of the fields.
        safety: gap asked for and timing errors to survive.
        start_counts: where the robots are [quanta], shape (n, 2); by default at the
            start of the trajectory.
        options: how it is done, by default as DiscretizeOptions says.
        progress: told now and then the part of the work done (0..1) and a few words.
        velocities: joint speeds the planner wrote at its points [rad/s], shape (n, 2, t), if
            any; only held against the limits.

    Raises:
        MotionError: trajectory, velocities or start_counts do not fit the plane.
    """
    options = options or DiscretizeOptions()
    tell = progress or (lambda part, words: None)
    tell(0.0, "checking the trajectory")
    start_counts = starting_counts(plane, trajectory, units, start_counts)
    reason = check_trajectory(plane, trajectory, start_counts, units, options, velocities)
    trajectory = _resting(trajectory, reason != Reason.OK)
    share = _by_turns if options.sharing == "turns" else share_by_halves
    wire, rounds = share(plane, trajectory, start_counts, units, safety, options, reason, tell)
    tell(0.8, "certifying")
    _, held, certificate = hold_until_safe(plane, wire.decoded(), safety)
    reason[held & (reason == Reason.OK)] = Reason.UNSAFE
    tell(1.0, "certified" if certificate.ok else "robots at rest are too close")
    reason.setflags(write=False)
    return Discretization(wire.without(held), reason, certificate, rounds)


def _resting(trajectory, robots):
    # the trajectory from time zero, with some robots resting where they begin
    angles = np.where(robots[:, None, None], trajectory.angles[:, :, :1], trajectory.angles)
    time_s = trajectory.time_s
    if len(time_s) == 1 or time_s[0] > 0.0:  # at least two points, the first at zero
        time_s = np.concatenate([[0.0], time_s if time_s[0] > 0.0 else [1.0]])
        angles = np.concatenate([angles[:, :, :1], angles], axis=2)
    return SampledMotion(time_s, angles)


def _by_turns(plane, trajectory, start_counts, units, safety, options, reason, tell):
    makespan_s = trajectory.time_s[-1] + _LATER_TICKS * units.tick_s
    draft = Draft(plane, units, start_counts, safety, makespan_s)
    candidates = Candidates(draft, trajectory, options)
    rounds = take_turns(draft, candidates, safety, options, tell)
    idle = np.flatnonzero(candidates.motors.astype(bool) & ~draft.counts().any(axis=1))
    reason[idle] = Reason.UNSAFE
    reason[candidates.too_many_segments(idle)] = Reason.TOO_MANY_SEGMENTS
    offsets, (ticks, velocity) = draft.segments.offsets, draft.segments.whole()
    return WireMotion(units, start_counts, offsets, ticks, velocity), rounds
