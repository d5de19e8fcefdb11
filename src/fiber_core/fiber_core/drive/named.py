# SPDX-License-Identifier: Apache-2.0
"""Drives by name, with figures of instruments."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from fiber_core.drive.drive import Drive
from fiber_core.errors import LayoutError
from fiber_core.focal_plane import FocalPlane
from fiber_core.wire_units import WireUnits

__all__ = ["DRIVES", "DriveFigures", "with_drive"]


@dataclass(frozen=True)
class DriveFigures:
    """Figures of a drive that are the same for all robots.

    Args:
        acceleration_deg_s2: highest acceleration of both joints [deg/s2]; inf is unlimited.
        uncertainty_deg: largest error of the angle of theta and of phi [deg].
        note: origin of the figures.
    """

    acceleration_deg_s2: float = float("inf")
    uncertainty_deg: tuple[float, float] = (0.0, 0.0)
    note: str = ""


DRIVES: Mapping[str, DriveFigures] = MappingProxyType(
    {
        "ideal": DriveFigures(note="Joints follow their orders exactly, at any speed."),
        "accelerated": DriveFigures(
            acceleration_deg_s2=2000.0,
            note="Any speed, reached at 2000 deg/s2 at most: the ramp is the time from rest to "
            "the highest speed of the plane.",
        ),
        "sdss_v": DriveFigures(
            uncertainty_deg=(1.5, 1.5),
            note="The error stack of the interface document: hysteresis 0.3, non-linearity 0.6, "
            "torque of the fibre 0.5, control 0.1 deg, all of one sign in both joints. With arms "
            "of 7.4 and 15 mm, 0.98 mm at the end of the arm; the document says 1.05 mm.",
        ),
    }
)


def with_drive(plane: FocalPlane, name: str) -> FocalPlane:
    """Return the same plane with another drive.

    A ramp lasts the whole number of ticks in which the fastest joint, starting from rest, reaches
    its highest speed.

    Args:
        plane: the focal plane.
        name: one of DRIVES.

    Raises:
        LayoutError: no drive has this name.
    """
    if name not in DRIVES:
        raise LayoutError(f"no drive is named {name!r}; there are {', '.join(DRIVES)}")
    figures = DRIVES[name]
    limit, tick_s = np.deg2rad(figures.acceleration_deg_s2), WireUnits.for_plane(plane).tick_s
    rise_s = float((plane.speeds / limit).max(initial=0.0))
    drive = Drive(
        plane.n,
        ramp_s=float(np.ceil(rise_s / tick_s - 1e-9)) * tick_s,
        acceleration_rad_s2=limit,
        uncertainty_rad=np.deg2rad(figures.uncertainty_deg),
        name=name,
    )
    return replace(plane, drive=drive)
