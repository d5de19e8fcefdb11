# SPDX-License-Identifier: Apache-2.0
"""Sites of a hexagonal grid, numbered from the centre outwards."""

from numbers import Real

import numpy as np

from fiber_core import bounds
from fiber_core.array_types import Points
from fiber_core.errors import LayoutError

__all__ = ["hexagonal_centers"]


def hexagonal_centers(robots: int, pitch_mm: float, hexagon: bool = True) -> Points:
    """Return the sites of a hexagonal grid that are nearest the centre [mm], shape (n, 2).

    Site k is the same for every number of robots.

    Args:
        robots: number of sites; 1, 7, 19, 37, ... 3 k (k + 1) + 1 fill k rings.
        pitch_mm: distance between neighbouring sites [mm].
        hexagon: whether the grid grows ring by ring of a hexagon; otherwise as a disc.

    Raises:
        LayoutError: the number of robots is not a whole number from 1 to bounds.MAX_ROBOTS.
    """
    if not (isinstance(robots, Real) and robots >= 1 and robots % 1 == 0):
        raise LayoutError(f"robots must be a positive integer, got {robots}")
    bounds.check_number(robots, "robots", 1, bounds.MAX_ROBOTS, LayoutError)
    count = int(robots)
    # The sites a e1 + b e2 nearest the centre, e1 and e2 60 degrees apart: by ring of the
    # hexagon or by a^2 + ab + b^2, the squared distance; from row to row where equal.
    # A disc of radius r holds 2 pi r^2 / sqrt(3) sites, give or take its rim.
    rings = int(np.ceil(np.sqrt(count * np.sqrt(3) / (2 * np.pi)) * 2 / np.sqrt(3))) + 3
    b, a = np.mgrid[-rings : rings + 1, -rings : rings + 1].reshape(2, -1)
    ring = np.maximum.reduce([np.abs(a), np.abs(b), np.abs(a + b)])
    order = np.lexsort([a, b, ring if hexagon else a * a + a * b + b * b])[:count]
    a, b = a[order], b[order]
    return pitch_mm * np.stack([a + 0.5 * b, np.sqrt(0.75) * b], axis=1)
