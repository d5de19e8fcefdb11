# SPDX-License-Identifier: Apache-2.0
"""From a planned trajectory to certified orders."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Codes, Mask
from fiber_core.clearance import Certificate, Safety, hold_until_safe
from fiber_core.drive import Breaches, Drive, carried_out, overloading
from fiber_core.drive.checks import accelerations, overloads
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion, SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer.listed import discretize_listed
from fiber_discretizer.makarem2014 import discretize_makarem2014
from fiber_discretizer.options import DiscretizeOptions, ProgressCallback
from fiber_discretizer.sequential import discretize_sequentially
from fiber_discretizer.validate import (
    check_size,
    check_trajectory,
    starting_counts,
    until_rest,
)

__all__ = ["Discretization", "discretize"]

_BY_SHARING = {
    "sequential": discretize_sequentially,
    "makarem2014": discretize_makarem2014,
}


@dataclass(frozen=True, eq=False)
class Discretization:
    """The orders of a plan, with the proof that they are safe.

    Args:
        wire: the motion in whole wire units; robots with a reason other than OK rest.
        reason: Reason of each robot, shape (n,): OK, BAD_TRAJECTORY, DISABLED,
            TOO_MANY_SEGMENTS, OVERLOAD or UNSAFE.
        certificate: certificate of wire.decoded() over the whole plane. It is not ok
            only where robots at rest are too close already, one of which could move.
        rounds: how often robots without a safe motion were tried again.
        breaches: rules of motors, joints and supplies that robots held here would break.
    """

    wire: WireMotion
    reason: Codes
    certificate: Certificate
    rounds: int
    breaches: Breaches = field(default_factory=Breaches.none)


def discretize(
    plane: FocalPlane,
    trajectory: SampledMotion,
    units: WireUnits,
    safety: Safety,
    start_counts: ArrayLike | None = None,
    options: DiscretizeOptions | None = None,
    progress: ProgressCallback | None = None,
    velocities: ArrayLike | None = None,
) -> Discretization:
    """Turn a planned trajectory into few constant-velocity segments that are proven safe.

    Between its points a trajectory is straight. Robots with profiles that cannot be used rest;
    the others get the fewest segments found with the sharing of `options`, rounded to whole
    units. For motors with listed speeds the trajectory is taken as it is. A robot that cannot be
    certified rests, with the reason.

    Args:
        plane: the focal plane.
        trajectory: joint profiles of all its robots.
        units: size of tick and quantum, and the widths of the fields.
        safety: gap asked for and timing errors to survive.
        start_counts: present encoder counts [quanta], shape (n, 2); by default those at the
            begin of the trajectory.
        options: options of the discretizer; by default as DiscretizeOptions says.
        progress: called with the fraction of the work that is done, 0..1, and a short text.
        velocities: joint velocities that the planner gave at its points [rad/s], shape
            (n, 2, t), or None; only compared with the limits.

    Raises:
        MotionError: trajectory, velocities or start_counts do not fit the plane, or the
            trajectory has more samples than an order can express.
    """
    options = options or DiscretizeOptions()
    check_size(trajectory)
    report = progress or _no_report
    report(0.0, "checking the trajectory")
    counts = starting_counts(plane, trajectory, units, start_counts)
    plane = plane.with_fixed_joints_at(units.to_angles(counts))
    reason, breaches = check_trajectory(plane, trajectory, counts, units, options, velocities)
    found = [breaches]
    trajectory = _with_robots_at_rest(trajectory, reason != Reason.OK)
    trajectory = until_rest(trajectory, units, options)
    if plane.drive.listed is not None:
        wire, reason, breaches = discretize_listed(
            plane, trajectory, counts, units, options, reason
        )
        found.append(breaches)
        rounds = 0
    else:
        wire, reason, rounds = _BY_SHARING[options.sharing](
            plane, trajectory, counts, units, safety, options, reason, report
        )
        given_up = reason == Reason.UNSAFE
        found.append(_too_hard(plane.drive, trajectory, given_up))
    report(0.8, "certifying")
    _, held, certificate = hold_until_safe(plane, wire.decoded(), safety)
    held_here = held & (reason == Reason.OK)
    reason[held_here] = Reason.UNSAFE
    if not plane.drive.is_ideal:
        found.append(_of_orders(plane, wire, held_here, reason))
    report(1.0, "certified" if certificate.ok else "robots at rest are too close")
    reason.setflags(write=False)
    return Discretization(wire.without(held), reason, certificate, rounds, Breaches.joined(found))


def _too_hard(drive: Drive, trajectory: SampledMotion, robots: Mask) -> Breaches:
    # robots for which no orders were found that change their speed slowly enough
    if drive.ramp_s == 0.0 or not robots.any():
        return Breaches.none()
    angles, steps = trajectory.angles[robots], np.diff(trajectory.time_s)
    profiles = 2 * len(angles)
    lines = SegmentMotion(
        angles[:, :, 0],
        np.arange(profiles + 1) * len(steps),
        np.tile(steps, profiles),
        (np.diff(angles, axis=2) / steps).ravel(),
    )
    own = drive.of_robots(np.flatnonzero(robots))
    return accelerations(own, carried_out(own, lines)).of_rows(np.flatnonzero(robots))


def _of_orders(plane: FocalPlane, wire: WireMotion, held: Mask, reason: Codes) -> Breaches:
    # The motions of held robots that their motors or supplies do not allow, with the values.
    # Robots that are too many for their supply get the Reason OVERLOAD.
    curves = carried_out(plane.drive, wire.decoded())
    too_hard = accelerations(plane.drive, curves)
    share = plane.drive.motors_on
    too_many = held & overloading(curves, plane.supply, share)
    reason[too_many] = Reason.OVERLOAD
    return Breaches.joined([too_hard, overloads(plane.supply, share, too_many)])


def _no_report(fraction: float, text: str) -> None:
    pass


def _with_robots_at_rest(trajectory: SampledMotion, robots: Mask) -> SampledMotion:
    # the trajectory from time zero, with some robots at rest where they begin
    time_s, is_late = trajectory.time_s, trajectory.time_s[0] > 0.0
    if not (robots.any() or is_late or len(time_s) == 1):
        return trajectory
    angles = np.where(robots[:, None, None], trajectory.angles[:, :, :1], trajectory.angles)
    if len(time_s) == 1 or is_late:  # at least two points, the first at zero
        time_s = np.concatenate([[0.0], time_s if is_late else [1.0]])
        angles = np.concatenate([angles[:, :, :1], angles], axis=2)
    return SampledMotion(time_s, angles)
