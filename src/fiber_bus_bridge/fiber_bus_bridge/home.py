# SPDX-License-Identifier: Apache-2.0
"""Motions of one segment a joint: home, and test turns."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Angles, Counts, Ints, Mask
from fiber_core.clearance import Certificate, Safety, hold_until_safe, levers_of
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["hold_beyond", "home_motion", "turn_motion"]

_ROUNDING_MM = 1e-9


def home_motion(
    units: WireUnits, start: Counts, high: Ints, speed: Ints, chosen: Mask
) -> WireMotion:
    """Return the motion that folds robots with one segment each, at their highest speed.

    The velocity is a whole number, so a joint stops short of its limit by fewer quanta than the
    move has ticks, never beyond the limit. A joint that is farther away than one segment reaches
    needs another call.

    Args:
        units: tick, quantum and widths.
        start: joint positions now [quanta], shape (n, 2).
        high: upper limits of phi [quanta], shape (n,).
        speed: highest speeds of phi [velocity units], shape (n,).
        chosen: robots to fold, shape (n,).
    """
    return _one_segment(units, start, 1, np.where(chosen, high - start[:, 1], 0), speed)


def turn_motion(
    units: WireUnits, start: Counts, turn: Ints, speed: Ints, chosen: Mask, joint: ArrayLike = 0
) -> WireMotion:
    """Return the motion that turns one joint of robots with one segment each.

    Args:
        units: tick, quantum and widths.
        start: joint positions now [quanta], shape (n, 2).
        turn: turn of each joint; a little less of it is ordered, never more [quanta], shape (n,).
        speed: speeds of the joint [velocity units], shape (n,).
        chosen: robots to turn, shape (n,).
        joint: 0 for theta, 1 for phi, one number or shape (n,).
    """
    return _one_segment(units, start, joint, np.where(chosen, turn, 0), np.maximum(speed, 1))


def _one_segment(
    units: WireUnits, start: Counts, joint: ArrayLike, distance: Ints, speed: Ints
) -> WireMotion:
    ticks = np.clip(-(-np.abs(distance) // np.maximum(speed, 1)), 1, units.max_ticks)
    velocity = np.sign(distance) * np.minimum(np.abs(distance) // ticks, speed)
    moves = velocity != 0
    segments = np.zeros((len(distance), 2), dtype=np.int64)
    column: Ints = np.broadcast_to(np.asarray(joint, dtype=np.int64), moves.shape)
    segments[np.arange(len(moves)), column] = moves
    offsets = Parts.from_counts(segments).offsets
    return WireMotion(units, start, offsets, ticks[moves], velocity[moves])


def hold_beyond(
    plane: FocalPlane,
    motion: SegmentMotion,
    safety: Safety,
    within_mm: ArrayLike,
    about: Angles | None = None,
) -> tuple[SegmentMotion, Mask, Certificate]:
    """Hold robots of which a point could move farther than a distance, wherever their arms are.

    The gaps of pairs take no part: places of arms may be unknown.

    Args:
        plane: the focal plane.
        motion: joint profiles of all robots, as ordered.
        safety: the timing errors.
        within_mm: the distance of each robot [mm], shape (n,) or one number.
        about: joint angles from which the distance counts [rad], shape (n, 2); by default the start
            of the motion. Robots that rest are not judged.

    Returns:
        As of hold_until_safe, with a certificate without pairs.
    """
    about = motion.start if about is None else about
    travel = np.maximum(motion.highest - about, about - motion.lowest)
    far = (travel * levers_of(plane)).sum(axis=1) > np.asarray(within_mm) + _ROUNDING_MM
    far &= motion.counts.any(axis=1)
    none = np.zeros((0, 2), dtype=np.int64)
    rest, held, certificate = hold_until_safe(plane, motion.without(far), safety, none)
    return rest, held | far, certificate
