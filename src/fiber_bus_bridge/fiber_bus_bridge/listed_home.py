# SPDX-License-Identifier: Apache-2.0
"""Home: phi to its upper limit, by motors with listed speeds in a run and an approach."""

import numpy as np

from fiber_bus_bridge.home import home_motion
from fiber_core.array_types import Counts, Ints, Mask
from fiber_core.drive.listed_units import listed_units
from fiber_core.focal_plane import FocalPlane
from fiber_core.motors import speeds_alone
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits

__all__ = ["folding_motion", "listed_home_motion", "segments_of_joint"]

_PHI, _FALLING, _RISING = 1, 0, 1


def folding_motion(
    plane: FocalPlane, units: WireUnits, start: Counts, high: Ints, speed: Ints, chosen: Mask
) -> WireMotion:
    """Return the motion that folds robots, as their motors can make it.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths.
        start: joint positions now [quanta], shape (n, 2).
        high: upper limits of phi [quanta], shape (n,).
        speed: highest speeds of phi [velocity units], shape (n,).
        chosen: robots to fold, shape (n,).
    """
    if plane.drive.listed is not None:
        return listed_home_motion(plane, units, start, high, chosen)
    alone = np.floor(speeds_alone(plane)[:, 1] / units.velocity_rad_s).astype(np.int64)
    return home_motion(units, start, high, np.minimum(speed, alone), chosen)


def listed_home_motion(
    plane: FocalPlane, units: WireUnits, start: Counts, high: Ints, chosen: Mask
) -> WireMotion:
    """Return the motion that folds robots with a run and an approach, theta still.

    No joint goes beyond its limit on the way. An approach with a rising angle ends within one
    velocity unit of it, any other as near as its way and a whole tick of the run allow. Robots rest
    that are nearer to their limit than the least run and the approach need.

    Args:
        plane: the focal plane; its motors have a list of speeds.
        units: tick, quantum and widths.
        start: joint positions now [quanta], shape (n, 2).
        high: upper limits of phi [quanta], shape (n,).
        chosen: robots to fold, shape (n,).
    """
    listed, table = plane.drive.listed, listed_units(plane, units)
    assert listed is not None
    number = listed.approach_speed
    rises = bool(listed.approach_sign[_PHI] > 0.0)
    run, creep = table.velocity[:, 0, _PHI, _RISING], table.velocity[:, number, _PHI]
    back, forth = table.back[:, _PHI], table.forth[:, _PHI].copy()
    down, up = creep[:, _FALLING], creep[:, _RISING]
    if rises:
        net, above = forth * up - back * down, np.maximum(forth * up - back * down, 0)
    else:
        net, above = back * up - forth * down, back * up
    distance = high - start[:, _PHI]
    ticks = np.where(chosen, (distance - above) // run, 0)
    moves = ticks >= table.least[:, 0, _PHI, _RISING]
    if rises:  # the last part makes up for what a whole tick of the run leaves
        forth += np.where(forth > 0, (distance - ticks * run - net) // up, 0)
    rest = table.ramp
    legs = np.stack([ticks, np.full_like(back, rest[0]), back, np.full_like(back, rest[number])])
    legs = np.vstack([legs, forth]) * moves
    legs[1] *= forth > 0  # without an approach nothing follows the run
    legs[3] *= back > 0
    sign = 1 if rises else -1
    still, ways = np.zeros_like(back), (down, up) if rises else (up, down)
    velocity = np.stack([run, still, -sign * ways[0], still, sign * ways[1]])
    return segments_of_joint(units, start, legs.T, velocity.T, np.ones(len(start), dtype=np.int64))


def segments_of_joint(
    units: WireUnits, start: Counts, legs: Ints, velocity: Ints, joint: Ints
) -> WireMotion:
    """Return the motion of one joint of robots in legs; one longer than a segment becomes several.

    Args:
        units: tick, quantum and widths.
        start: joint positions now [quanta], shape (n, 2).
        legs: durations, 0 for none [ticks], shape (n, k).
        velocity: of each leg [velocity units], shape (n, k).
        joint: the joint that moves, 0 for theta, 1 for phi, shape (n,).
    """
    pieces = -(-legs // units.max_ticks)
    ticks = np.full(pieces.sum(), units.max_ticks)
    last = np.cumsum(pieces.ravel())[pieces.ravel() > 0] - 1
    left = legs - (pieces - 1) * units.max_ticks
    ticks[last] = left[pieces > 0]
    counts = np.zeros((len(legs), 2), dtype=np.int64)
    counts[np.arange(len(legs)), joint] = pieces.sum(axis=1)
    offsets = Parts.from_counts(counts).offsets
    return WireMotion(units, start, offsets, ticks, np.repeat(velocity, pieces.ravel()))
