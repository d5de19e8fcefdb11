# SPDX-License-Identifier: Apache-2.0
"""Results as the fibre map of an SDSS-V confSummary: a yanny file with one row a fibre."""

import os
from pathlib import Path

import numpy as np

from fiber_core.array_types import Angles, Codes
from fiber_core.focal_plane import FocalPlane
from fiber_core.kinematics import fibre_places
from fiber_core.outcomes import Reason
from fiber_formats.errors import FormatError
from fiber_formats.result_forms import sdss_columns
from fiber_formats.writing import write_whole

__all__ = ["check_fibres", "is_fibre_map", "write_fibre_map"]

_TIP = "METROLOGY"
_KINDS = ("BOSS", "APOGEE", _TIP)
_MEMBERS = {
    "positionerId": "long",
    "fiberType": "FIBERTYPE",
    "assigned": "short",
    "on_target": "short",
    "valid": "short",
    "decollided": "short",
    "xwok": "double",
    "ywok": "double",
    "alpha": "double",
    "beta": "double",
}


def is_fibre_map(path: str | os.PathLike[str]) -> bool:
    """Return whether a path names a yanny file: .par, also with .gz."""
    suffixes = [suffix.lower() for suffix in Path(path).suffixes]
    return suffixes[-1:] == [".par"] or suffixes[-2:] == [".par", ".gz"]


def check_fibres(path: str | os.PathLike[str], plane: FocalPlane) -> None:
    """Check that a plane has the fibres of SDSS-V.

    Raises:
        FormatError: it has others or none; names path and fibres.
    """
    if set(plane.fibre_names) != set(_KINDS):
        has = ", ".join(plane.fibre_names) or "none"
        raise FormatError(f"{path}: a .par has the fibres {', '.join(_KINDS)}, the plane has {has}")


def write_fibre_map(
    path: str | os.PathLike[str],
    plane: FocalPlane,
    outcome: Codes,
    reason: Codes,
    angles: Angles,
    fibre: Codes,
) -> None:
    """Write where each fibre of each robot is, and which of them was for a target.

    Each robot has three rows, one for each fibre. `assigned` and `on_target` hold for the fibre of
    the target alone, `valid` and `decollided` for the robot. The readers of starts and targets of a
    confSummary read it back: the angles, and the reached places of the robots that had targets.

    Args:
        path: where to; an existing file is replaced.
        plane: the focal plane.
        outcome: Outcome of each robot, shape (n,).
        reason: Reason of each robot, shape (n,).
        angles: joint angles after the motion [rad], shape (n, 2).
        fibre: number of the fibre that counts for the target of each, shape (n,).

    Raises:
        FormatError: the plane has other fibres than those of SDSS-V or none, a target is for the
            metrology fibre, or the file cannot be written.
    """
    check_fibres(path, plane)
    names = plane.fibre_names
    asked = reason != Reason.NO_TARGET
    tips = plane.ids[asked & (np.array(names)[fibre] == _TIP)]
    if len(tips):
        raise FormatError(f"{path}: the target of robot {tips[0]} is for the fibre {_TIP}")
    places = fibre_places(plane, angles)
    nowhere = np.full(plane.n, np.nan)
    of = sdss_columns(plane, outcome, reason, places[:, 0], angles, nowhere)
    lines = [_HEAD]
    for k, robot in enumerate(plane.ids.tolist()):
        for number, name in enumerate(names):
            own = number == fibre[k]
            flags = [of["assigned"][k] * own, of["on_target"][k] * own, of["valid"][k]]
            numbers = [*places[k, number], of["alpha"][k], of["beta"][k]]
            words = [robot, name, *flags, of["decollided"][k], *map(float, numbers)]
            lines.append(f"FIBERMAP {' '.join(map(str, words))}\n")
    write_whole(path, "".join(lines).encode())


_HEAD = (
    "#%yanny\n"
    f"typedef enum {{\n    {', '.join(_KINDS)}\n}} FIBERTYPE;\n\n"
    "typedef struct {\n"
    + "".join(f"    {kind} {name};\n" for name, kind in _MEMBERS.items())
    + "} FIBERMAP;\n\n"
)
