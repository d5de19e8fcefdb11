# SPDX-License-Identifier: Apache-2.0
"""What the tables of DESI have in common: petals, and geometry that a plane cannot express yet."""

import numpy as np

from fiber_core.array_types import Floats, Ints
from fiber_formats.columns import Columns

__all__ = ["expansion_notices", "petal_angle_deg"]

_EXPANSIONS = (
    "KEEPOUT_EXPANSION_PHI_RADIAL",
    "KEEPOUT_EXPANSION_PHI_ANGULAR",
    "KEEPOUT_EXPANSION_THETA_RADIAL",
    "KEEPOUT_EXPANSION_THETA_ANGULAR",
)


def petal_angle_deg(petal: Ints) -> Floats:
    """Return how far each petal is turned in the focal plane [deg], given its place 0 to 9."""
    return 36.0 * (petal.astype(float) - 3.0)


def expansion_notices(columns: Columns) -> tuple[str, ...]:
    """Return notices of larger keep-outs and of robots that may only travel retracted."""
    notices: tuple[str, ...] = ()
    present = [name for name in _EXPANSIONS if name in columns]
    larger = np.zeros(len(columns), dtype=bool)
    for name in present:
        larger |= np.nan_to_num(columns.numbers(name, missing=True)) != 0
    if larger.any():
        notices += (f"keep-out expansions of {np.count_nonzero(larger)} robots are not used",)
    if "CLASSIFIED_AS_RETRACTED" in columns:
        retracted = np.count_nonzero(columns.flags("CLASSIFIED_AS_RETRACTED"))
        if retracted:
            notices += (f"{retracted} robots are classified as retracted; that is not used",)
    for name in ("LINPHI", "LINTHETA"):
        if name in columns and columns.flags(name).any():
            linear = np.count_nonzero(columns.flags(name))
            notices += (f"{linear} robots have a linear motor ({name}); that is not used",)
    return notices
