# SPDX-License-Identifier: Apache-2.0
"""The drive of a plane from the columns of a table."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fiber_core import FocalPlane, with_accelerations, with_drive
from fiber_core.array_types import Floats
from fiber_core.drive import Drive
from fiber_core.errors import LayoutError

__all__ = ["ACCELERATIONS", "gears_of", "same_for_all", "with_motors"]

ACCELERATIONS = ("theta_acceleration_deg_s2", "phi_acceleration_deg_s2")


def gears_of(columns: Mapping[str, NDArray]) -> Drive | None:
    """Return what a table tells of each robot's gears, joints and supply; None without a column.

    Args:
        columns: columns of a layout by name, in the order of the plane.

    Raises:
        LayoutError: a value is out of range; names the robot.
    """
    names = [f"{joint}_scale_{way}" for joint in ("theta", "phi") for way in ("falling", "rising")]
    known = [name for name in names if name in columns]
    of_joints = [
        [f"{joint}_{what}_deg" for joint in ("theta", "phi")]
        for what in ("uncertainty", "lost_motion")
    ]
    known += [name for pair in of_joints for name in pair if name in columns]
    if not known and "supply" not in columns:
        return None
    n = len(columns["id"])

    def of(name: str, otherwise: float) -> Floats:
        return np.asarray(columns.get(name, np.full(n, otherwise)))

    uncertainty, lost = (
        np.deg2rad(np.stack([of(name, 0.0) for name in pair], axis=1)) for pair in of_joints
    )
    scale = np.stack([of(name, 1.0) for name in names], axis=1).reshape(n, 2, 2)
    return Drive(
        n,
        uncertainty_rad=uncertainty,
        lost_motion_rad=lost,
        scale=scale,
        supply=columns.get("supply"),
        ids=columns["id"],
    )


def with_motors(plane: FocalPlane, columns: Mapping[str, NDArray]) -> FocalPlane:
    """Return the plane with the motors that its table tells, ideal ones without a column.

    Args:
        plane: the plane, with its gears.
        columns: columns of a layout by name, in the order of the plane.

    Raises:
        LayoutError: the table tells two drives, there is no such drive, or a value is out of range.
    """
    limits = [name for name in ACCELERATIONS if name in columns]
    if "drive" in columns and limits:
        raise LayoutError(f"there are columns drive and {', '.join(limits)}: one of them is meant")
    if limits:
        unlimited = np.full(plane.n, np.inf)
        per_joint = [columns.get(name, unlimited) for name in ACCELERATIONS]
        plane = with_accelerations(plane, np.deg2rad(np.stack(per_joint, axis=1)))
    if "drive" in columns:
        plane = with_drive(plane, str(columns["drive"][0]))
    if "motors_on" in columns:
        share = same_for_all(columns, "motors_on")
        plane = replace(plane, drive=replace(plane.drive, motors_on=share))
    return plane


def same_for_all(columns: Mapping[str, NDArray], name: str) -> float:
    """Return the number that a column has in every row.

    Args:
        columns: columns of a layout by name.
        name: the column.

    Raises:
        LayoutError: rows differ; names the column.
    """
    values = columns[name]
    if np.ptp(values):
        least, most = values.min(), values.max()
        raise LayoutError(f"column {name} is {least} to {most}; it holds for all robots")
    return float(values[0])
