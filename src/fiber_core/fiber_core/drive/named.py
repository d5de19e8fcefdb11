# SPDX-License-Identifier: Apache-2.0
"""Drives by name, with figures of instruments."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Angles, Floats, Ints
from fiber_core.drive.drive import MAX_RAMP_S, Drive
from fiber_core.drive.listed import ListedSpeeds
from fiber_core.drive.power import motors_allowed
from fiber_core.errors import LayoutError
from fiber_core.focal_plane import FocalPlane
from fiber_core.validation import frozen_array
from fiber_core.wire_units import WireUnits

__all__ = ["DRIVES", "DriveFigures", "check_share", "with_accelerations", "with_drive", "with_name"]


@dataclass(frozen=True)
class DriveFigures:
    """Figures of a drive that are the same for all robots.

    Args:
        acceleration_deg_s2: highest acceleration of both joints [deg/s2]; inf is unlimited.
        uncertainty_deg: largest error of the angle of theta and of phi [deg].
        speeds_deg_s: speeds of motors that have only a few, falling [deg/s]; empty for any speed.
        ramps_s: ramp of each of these speeds [s].
        least_deg: least move of a motor at each of them [deg].
        approach_deg: last move of a joint, in one direction at the lowest speed [deg].
        approach_sign: its direction in theta and in phi.
        returns: whether the same distance back comes before it.
        robots_a_supply: robots that share a power supply, in the order of their ids; None for all
            of a bus.
        note: origin of the figures.
    """

    acceleration_deg_s2: float = float("inf")
    uncertainty_deg: tuple[float, float] = (0.0, 0.0)
    speeds_deg_s: tuple[float, ...] = ()
    ramps_s: tuple[float, ...] = ()
    least_deg: tuple[float, ...] = ()
    approach_deg: float = 0.0
    approach_sign: tuple[float, float] = (-1.0, 1.0)
    returns: bool = False
    robots_a_supply: int | None = None
    note: str = ""


DRIVES: Mapping[str, DriveFigures] = MappingProxyType(
    {
        "ideal": DriveFigures(note="Joints follow their orders exactly, at any speed."),
        "accelerated": DriveFigures(
            acceleration_deg_s2=2000.0,
            note="Any speed, reached at 2000 deg/s2 at most: the ramp is the time from rest to "
            "the highest speed of the plane.",
        ),
        "desi": DriveFigures(
            speeds_deg_s=(176.0, 2.67),
            ramps_s=(0.022, 0.0),
            least_deg=(4.53, 0.0),
            approach_deg=3.0,
            returns=True,
            robots_a_supply=251,
            note="Cruise and creep of plate control, calibration of March 2026; a move ends with "
            "3 deg back and 3 deg forth in creep, theta falling and phi rising. DESI's ramp has 33 "
            "steps and turns 2.0 deg; an even one of 22 ms turns 1.94 deg.",
        ),
        "sdss_v": DriveFigures(
            uncertainty_deg=(1.5, 1.5),
            note="The error stack of the interface document: hysteresis 0.3, non-linearity 0.6, "
            "torque of the fibre 0.5, control 0.1 deg, all of one sign in both joints. With arms "
            "of 7.4 and 15 mm, 0.98 mm at the end of the arm; the document says 1.05 mm.",
        ),
    }
)


def with_drive(plane: FocalPlane, name: str, motors_on: float | None = None) -> FocalPlane:
    """Return the same plane with another drive.

    A ramp lasts the whole number of ticks in which the fastest joint, starting from rest, reaches
    its highest speed. What the plane knows of each robot, scale, lost motion, uncertainty and
    supply, stays; what it has from a named drive goes with that drive. Of the uncertainty of
    a robot and that of a drive a plane has only the larger one.

    Args:
        plane: the focal plane.
        name: one of DRIVES.
        motors_on: largest share of the motors of a supply that may turn at once; by default that
            of the plane.

    Raises:
        LayoutError: no drive has this name, the share is out of range, or it is less than one
            motor of a supply.
    """
    if name not in DRIVES:
        raise LayoutError(f"no drive is named {name!r}; there are {', '.join(DRIVES)}")
    figures, units = DRIVES[name], WireUnits.for_plane(plane)
    limit, before = np.deg2rad(figures.acceleration_deg_s2), plane.drive
    own_rad, supply = _own(before)
    if supply is None:
        supply = _supply(figures, plane.n)
    drive = Drive(
        plane.n,
        ramp_s=_ramp_s(plane, limit),
        acceleration_rad_s2=limit,
        uncertainty_rad=np.maximum(np.deg2rad(figures.uncertainty_deg), own_rad),
        name=name,
        listed=_listed(figures, units.velocity_rad_s),
        scale=before.scale,
        lost_motion_rad=before.lost_motion_rad,
        supply=supply,
        motors_on=before.motors_on if motors_on is None else motors_on,
    )
    equipped = replace(plane, drive=drive)
    check_share(equipped)
    return equipped


def with_accelerations(plane: FocalPlane, acceleration_rad_s2: ArrayLike) -> FocalPlane:
    """Return the same plane with motors of any speed, each with an acceleration of its own.

    The ramp lasts the whole number of ticks in which the slowest of all motors reaches its highest
    speed from rest. The rest of the drive stays; its name becomes `own`.

    Args:
        plane: the focal plane; its motors have no listed speeds.
        acceleration_rad_s2: highest acceleration of each joint [rad/s2], shape (n, 2); inf is
            unlimited.

    Raises:
        LayoutError: an acceleration is out of range, or the motors have listed speeds; names the
            robot.
    """
    limit = frozen_array(
        acceleration_rad_s2, np.float64, (plane.n, 2), "accelerations", LayoutError
    )
    with np.errstate(divide="ignore"):
        rise_s = plane.speeds / limit
    slow = ~((limit > 0.0) & (rise_s <= MAX_RAMP_S)).all(axis=1)  # nan is slow
    if slow.any():
        at = int(np.argmax(slow))
        raise LayoutError(
            f"robot {plane.ids[at]}: accelerations must be above 0 and give full speed within "
            f"{MAX_RAMP_S:g} s, got {np.rad2deg(limit[at]).tolist()} deg/s2"
        )
    ramp_s = _ramp_s(plane, limit)
    drive = replace(plane.drive, ramp_s=ramp_s, acceleration_rad_s2=limit, name="own")
    return replace(plane, drive=drive)


def with_name(plane: FocalPlane) -> FocalPlane:
    """Return the same plane with its drive called as in DRIVES, or `own` if none has its numbers.

    Args:
        plane: the focal plane; the name of its drive has no effect.
    """
    drive = replace(plane.drive, name="own")
    for name in reversed(list(DRIVES)):  # `ideal` is also all others' uncertainty alone
        of_name = with_drive(replace(plane, drive=drive), name, motors_on=1.0).drive
        uncertainty_rad = np.deg2rad(DRIVES[name].uncertainty_deg)
        if uncertainty_rad.any() and not (drive.uncertainty_rad == uncertainty_rad).any():
            continue
        if replace(drive, name=name, motors_on=1.0) == of_name:
            return replace(plane, drive=replace(drive, name=name))
    return replace(plane, drive=drive)


def check_share(plane: FocalPlane) -> None:
    """Refuse a plane with a supply that may not feed a single motor.

    Raises:
        LayoutError: names the supply and the share.
    """
    share, supply = plane.drive.motors_on, plane.supply
    none = motors_allowed(supply, share) < 1
    if none.any():
        number = int(supply[np.argmax(none)])
        motors = 2 * int((supply == number).sum())
        raise LayoutError(
            f"supply {number}: {share:.3g} of its {motors} motors is {share * motors:.3g}, and "
            f"less than one motor moves no robot"
        )


def _ramp_s(plane: FocalPlane, limit_rad_s2: float | Floats) -> float:
    tick_s = WireUnits.for_plane(plane).tick_s
    rise_s = float((plane.speeds / limit_rad_s2).max(initial=0.0))
    return float(np.ceil(rise_s / tick_s - 1e-9)) * tick_s


def _own(drive: Drive) -> tuple[Angles, Ints | None]:
    # uncertainty and supply of each robot that are not those of the named drive it has
    figures = DRIVES.get(drive.name)
    if figures is None:
        return drive.uncertainty_rad, drive.supply
    of_drive = drive.uncertainty_rad == np.deg2rad(figures.uncertainty_deg)
    supply = _supply(figures, drive.n)
    own = drive.supply
    if own is not None and supply is not None and np.array_equal(own, supply):
        own = None
    return np.where(of_drive, 0.0, drive.uncertainty_rad), own


def _supply(figures: DriveFigures, n: int) -> Ints | None:
    return None if figures.robots_a_supply is None else np.arange(n) // figures.robots_a_supply


def _listed(figures: DriveFigures, unit_rad_s: float) -> ListedSpeeds | None:
    # speeds of orders are whole numbers of a unit
    if not figures.speeds_deg_s:
        return None
    return ListedSpeeds(
        np.deg2rad(figures.speeds_deg_s),
        np.array(figures.ramps_s),
        np.deg2rad(figures.least_deg),
        tolerance_rad_s=unit_rad_s,
        approach_rad=np.deg2rad([figures.approach_deg] * 2),
        approach_sign=np.array(figures.approach_sign),
        approach_speed=len(figures.speeds_deg_s) - 1,
        returns=figures.returns,
    )
