# SPDX-License-Identifier: Apache-2.0
"""Columns of results in the form of an instrument, added to our own."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from fiber_core.array_types import Angles, Codes, Floats, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome, Reason

__all__ = ["FORMS", "PAIRS", "desi_columns", "pfs_columns", "sdss_columns"]

Form: TypeAlias = Callable[
    [FocalPlane, Codes, Codes, Points, Angles, Floats], Mapping[str, NDArray]
]

# bits of FIBERSTATUS: desispec, maskbits.py, fibermask
_UNASSIGNED, _STUCK, _BAD, _POOR = 1 << 0, 1 << 1, 1 << 9, 1 << 10
# FiberStatus of PFS: Subaru-PFS/datamodel, pfsConfig.py
_GOOD, _BROKEN_COBRA, _NOT_CONVERGED = 1, 6, 7
_BAD_UM, _POOR_UM = 100.0, 30.0


def desi_columns(
    plane: FocalPlane,
    outcome: Codes,
    reason: Codes,
    reached_mm: Points,
    angles: Angles,
    error_um: Floats,
) -> dict[str, NDArray]:
    """Return LOCATION, FIBER_X, FIBER_Y and FIBERSTATUS, as of a DESI fibre map.

    Bits of FIBERSTATUS: 0 no target, 1 the robot is disabled, 9 more than 100 um from the target,
    10 more than 30 um.
    """
    unassigned = reason == Reason.NO_TARGET
    status = np.where(unassigned, _UNASSIGNED, 0)
    status |= np.where(~plane.enabled, _STUCK, 0)
    status |= np.where(error_um > _BAD_UM, _BAD, 0)  # nan without target is neither
    status |= np.where(error_um > _POOR_UM, _POOR, 0)
    return {
        "LOCATION": plane.ids,
        "FIBER_X": reached_mm[:, 0],
        "FIBER_Y": reached_mm[:, 1],
        "FIBERSTATUS": status.astype(np.int64),
    }


def sdss_columns(
    plane: FocalPlane,
    outcome: Codes,
    reason: Codes,
    reached_mm: Points,
    angles: Angles,
    error_um: Floats,
) -> dict[str, NDArray]:
    """Return columns of a confSummary, one row a robot; places are those of the tip.

    alpha and beta count from the lower stops; `assigned` had a target, `on_target` reached it,
    `valid` did not fail, `decollided` had a target and was held away from it.
    """
    from_stop = np.rad2deg(angles - plane.limits[:, :, 0])
    assigned = reason != Reason.NO_TARGET
    return {
        "positionerId": plane.ids,
        "alpha": from_stop[:, 0],
        "beta": from_stop[:, 1],
        "xwok": reached_mm[:, 0],
        "ywok": reached_mm[:, 1],
        "assigned": assigned.astype(np.int64),
        "on_target": (outcome == Outcome.REACHED).astype(np.int64),
        "valid": (outcome != Outcome.FAILED).astype(np.int64),
        "decollided": (assigned & (outcome == Outcome.HELD)).astype(np.int64),
    }


def pfs_columns(
    plane: FocalPlane,
    outcome: Codes,
    reason: Codes,
    reached_mm: Points,
    angles: Angles,
    error_um: Floats,
) -> dict[str, NDArray]:
    """Return cobraId, pfiCenter and fiberStatus, as of a pfsConfig.

    fiberStatus is 1 (good), 6 for a disabled robot, or 7 where a target was not reached. pfiCenter
    has two numbers a row, which CSV cannot hold.
    """
    missed = (reason != Reason.NO_TARGET) & (outcome != Outcome.REACHED)
    status = np.where(missed, _NOT_CONVERGED, _GOOD)
    return {
        "cobraId": plane.ids,
        "pfiCenter": reached_mm,
        "fiberStatus": np.where(plane.enabled, status, _BROKEN_COBRA),
    }


FORMS: Mapping[str, Form] = MappingProxyType(
    {"desi": desi_columns, "sdss_v": sdss_columns, "pfs": pfs_columns}
)
PAIRS: Mapping[str, tuple[str, ...]] = MappingProxyType({"pfs": ("pfiCenter",)})  # x, y a row
