# SPDX-License-Identifier: Apache-2.0
"""Lists of speeds in whole wire units: what orders and configurations of robots are made of."""

from dataclasses import dataclass

import numpy as np

from fiber_core.array_types import Ints
from fiber_core.errors import LayoutError
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits

__all__ = ["ListedUnits", "listed_units"]


@dataclass(frozen=True, eq=False)
class ListedUnits:
    """The listed speeds of n robots in whole units; joint, then direction (falling, rising).

    Args:
        velocity: speed of each joint at each listed speed of its motor [velocity units], shape
            (n, k, 2, 2): robot, speed, joint, direction.
        least: ticks of the least move at each speed, shape (n, k, 2, 2).
        ramp: ticks of rest that a move at each speed needs behind it, shape (k,).
        back, forth: least ticks of either part of the approach, 0 for none, shape (n, 2).
    """

    velocity: Ints
    least: Ints
    ramp: Ints
    back: Ints
    forth: Ints


def listed_units(plane: FocalPlane, units: WireUnits) -> ListedUnits:
    """Return the listed speeds of a plane in whole units.

    The highest speed is rounded down, so that no joint is faster than it may be, the others to
    the nearest unit.

    Args:
        plane: the focal plane, with listed speeds.
        units: size of tick and quantum.

    Raises:
        LayoutError: a speed is below one velocity unit, or two speeds are the same whole number of
            them; names the robot and the values.
    """
    listed, scale = plane.drive.listed, plane.drive.scale[:, None]
    assert listed is not None
    exact = listed.speeds_rad_s[:, None, None] * scale / units.velocity_rad_s
    velocity = np.rint(exact).astype(np.int64)
    velocity[:, 0] = np.floor(exact[:, 0] + 1e-9)
    slow = (velocity < 1).any(axis=(1, 2, 3))
    if slow.any():
        row = int(np.argmax(slow))
        raise LayoutError(
            f"robot {plane.ids[row]}: a speed of {listed.speeds_rad_s[-1]:.3g} rad/s times "
            f"{scale[row].min():.3g} is below one velocity unit, {units.velocity_rad_s:.3g} rad/s"
        )
    _check_apart(plane, units, velocity)
    turn = listed.least_rad[:, None, None] * scale / units.quantum_rad
    least = np.maximum(np.ceil(turn / velocity - 1e-9), 1).astype(np.int64)
    rising, joints = (listed.approach_sign > 0.0).astype(np.int64), np.arange(2)
    creep = velocity[:, listed.approach_speed]
    quanta = np.ceil(listed.approach_rad / units.quantum_rad).astype(np.int64)
    forth = -(-quanta // creep[:, joints, rising])
    back = -(-quanta // creep[:, joints, 1 - rising]) if listed.returns else np.zeros_like(forth)
    ramp = np.ceil(listed.ramp_s / units.tick_s - 1e-9).astype(np.int64)
    return ListedUnits(velocity, least, ramp, back, forth)


def _check_apart(plane: FocalPlane, units: WireUnits, velocity: Ints) -> None:
    """Refuse lists of which two speeds are one in whole units: robots would refuse them."""
    same = velocity[:, 1:] >= velocity[:, :-1]
    if not same.any():
        return
    row, slower, joint, way = (int(k) for k in np.argwhere(same)[0])
    listed, scale = plane.drive.listed, plane.drive.scale[row, joint, way]
    assert listed is not None
    fast, slow = listed.speeds_rad_s[slower : slower + 2] * scale
    raise LayoutError(
        f"robot {plane.ids[row]}: listed speeds of {fast:.6g} and {slow:.6g} rad/s of "
        f"{('theta', 'phi')[joint]} are both {velocity[row, slower, joint, way]} velocity units, "
        f"{units.velocity_rad_s:.3g} rad/s each"
    )
