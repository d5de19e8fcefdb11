# SPDX-License-Identifier: Apache-2.0
"""What the tables of DESI have in common: petals, and motors that a plane does not know."""

import numpy as np

from fiber_core.array_types import Bools, Floats, Ints
from fiber_formats.columns import Columns

__all__ = ["motor_notices", "petal_angle_deg"]


def petal_angle_deg(petal: Ints) -> Floats:
    """Return how far each petal is turned in the focal plane [deg], given its place 0 to 9."""
    return 36.0 * (petal.astype(float) - 3.0)


def linear_motors(columns: Columns, name: str) -> Bools:
    """Return which robots a column says to have a linear motor, shape (rows,)."""
    words = np.char.lower(columns.words(name, missing=True))
    return np.isin(words, ("true", "t", "1"))


def motor_notices(columns: Columns) -> tuple[str, ...]:
    """Return notices of linear motors and of robots that may only travel retracted."""
    notices: tuple[str, ...] = ()
    if "CLASSIFIED_AS_RETRACTED" in columns:
        retracted = np.count_nonzero(columns.flags("CLASSIFIED_AS_RETRACTED"))
        if retracted:
            notices += (f"{retracted} robots are classified as retracted; that is not used",)
    for name in ("LINPHI", "LINTHETA", "ZENO_MOTOR_P", "ZENO_MOTOR_T"):
        if name in columns:
            linear = np.count_nonzero(linear_motors(columns, name))
            if linear:
                use = _use_of_scales(columns, name[-1])
                notices += (f"{linear} robots have a linear motor ({name}): {use}",)
    return notices


def _use_of_scales(columns: Columns, joint: str) -> str:
    # what becomes of the scales of a joint, of which a table has one for each direction
    scales = [f"SZ_{way}_{joint}" for way in ("CW", "CCW")]
    absent = [name for name in scales if name not in columns]
    if len(absent) == len(scales):
        return "its speed is not used"
    use = "drives with listed speeds use its scale"
    return f"{use}; there is no column {absent[0]}: that way it counts as 1" if absent else use
