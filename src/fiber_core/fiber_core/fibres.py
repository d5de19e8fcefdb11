# SPDX-License-Identifier: Apache-2.0
"""Fibres: where they sit on the phi links, and which of them each target is for."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import bounds
from fiber_core.array_types import Floats, Ints
from fiber_core.errors import LayoutError
from fiber_core.validation import frozen_array

__all__ = ["ANY_FIBRE", "MOST_FIBRES", "checked_choice", "checked_fibres", "checked_names"]

ANY_FIBRE = -1  # the target leaves the choice of the fibre
MOST_FIBRES = 16  # of one robot; the most in use are three


def checked_fibres(fibres: ArrayLike, ids: Ints) -> Floats:
    """Return fibres as a read-only array [mm], shape (n, f, 2).

    Args:
        fibres: place of each fibre in the frame of the phi link: x along the arm, origin at the
            elbow [mm], shape (n, f, 2); f = 0 for one fibre at the tip.
        ids: robot ids, for messages, shape (n,).

    Raises:
        LayoutError: there are too many, or a fibre is out of bounds or at its elbow, where no
            phi could move it; names the robot.
    """
    checked = frozen_array(fibres, np.float64, (len(ids), None, 2), "fibres", LayoutError)
    if checked.shape[1] > MOST_FIBRES:
        raise LayoutError(f"a robot has {checked.shape[1]} fibres, expected at most {MOST_FIBRES}")
    from_elbow = np.hypot(checked[..., 0], checked[..., 1])
    good = (from_elbow >= bounds.MIN_LENGTH_MM) & (from_elbow <= bounds.MAX_LENGTH_MM)
    if not good.all():  # nan is not good
        row, number = (int(at[0]) for at in np.nonzero(~good))
        raise LayoutError(
            f"robot {ids[row]}: fibre {number} must be {bounds.MIN_LENGTH_MM:.6g} to "
            f"{bounds.MAX_LENGTH_MM:.6g} mm from the elbow, got {checked[row, number].tolist()}"
        )
    return checked


def checked_names(names: tuple[str, ...] | None, number: int) -> tuple[str, ...]:
    """Return the names of the fibres of a robot; without names their numbers.

    Raises:
        LayoutError: there are more or fewer names than fibres, or one is empty, given twice or
            cannot be printed.
    """
    if not names:
        return tuple(str(k) for k in range(number))
    usual = all(
        name and name.isprintable() for name in names
    )  # a line break parts them on the wire
    if len(names) != number or len(set(names)) != number or not usual:
        raise LayoutError(f"fibre_names are {names!r}, expected {number} different names")
    return tuple(names)


def checked_choice(fibre: ArrayLike | None, number: int, ids: Ints) -> Ints:
    """Return the number of the fibre that each target is for as a read-only array, shape (n,).

    Args:
        fibre: numbers of fibres, -1 where any may be on the target, shape (n,); None for any.
        number: how many fibres a robot has, at least 1.
        ids: robot ids, for messages, shape (n,).

    Raises:
        LayoutError: a robot has no such fibre; names it.
    """
    fibre = np.full(len(ids), ANY_FIBRE) if fibre is None else fibre
    checked = frozen_array(fibre, np.int64, (len(ids),), "fibre", LayoutError)
    bad = (checked < ANY_FIBRE) | (checked >= number)
    if bad.any():
        row = int(np.argmax(bad))
        raise LayoutError(
            f"robot {ids[row]}: fibre must be 0 to {number - 1}, or {ANY_FIBRE} for any, "
            f"got {checked[row]}"
        )
    return checked
