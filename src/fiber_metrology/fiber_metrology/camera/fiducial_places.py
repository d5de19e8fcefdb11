# SPDX-License-Identifier: Apache-2.0
"""Places for the fiducials of a simulated plane: between robots, evenly over the plane."""

import numpy as np
from scipy.spatial import Delaunay

from fiber_core.array_types import Points
from fiber_core.focal_plane import FocalPlane
from fiber_metrology.errors import MetrologyError

__all__ = ["fiducial_places"]

_EVEN = 1.6  # the longest side of a triangle over the usual one


def fiducial_places(plane: FocalPlane, count: int = 120) -> Points:
    """Return places between the robots, each as far from the others as there is one.

    Args:
        plane: the focal plane, of three robots or more.
        count: number of fiducials.

    Returns:
        Places [mm], shape (min(count, number of gaps), 2).

    Raises:
        MetrologyError: the plane has no three robots around a gap.
    """
    if plane.n < 3:
        raise MetrologyError(f"a plane of {plane.n} robots has no gap for a fiducial")
    triangles = plane.centers[Delaunay(plane.centers).simplices]
    sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
    gaps = triangles[sides < _EVEN * np.median(sides)].mean(axis=1)
    middle = gaps.mean(axis=0)
    chosen = [int(np.argmax(np.hypot(*(gaps - middle).T)))]
    nearest = np.hypot(*(gaps - gaps[chosen[0]]).T)
    for _ in range(min(count, len(gaps)) - 1):
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, np.hypot(*(gaps - gaps[chosen[-1]]).T))
    return gaps[chosen]
