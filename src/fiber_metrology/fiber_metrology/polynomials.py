# SPDX-License-Identifier: Apache-2.0
"""Polynomial maps of the plane: from pixels to mm, and corrections of such maps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats
from fiber_metrology.errors import MetrologyError

__all__ = ["PolynomialMap", "fit_map"]


@dataclass(frozen=True, eq=False)
class PolynomialMap:
    """A map of points whose two coordinates are polynomials of the two coordinates given.

    With u = (point - centre) / radius the map is sum_k c_k u_x^i u_y^j, i + j <= degree.

    Args:
        centre: middle of the points, shape (2,).
        radius: scale of the points, positive.
        degree: total degree.
        coefficients: shape (terms, 2).
    """

    centre: Floats
    radius: float
    degree: int
    coefficients: Floats

    def __call__(self, points: ArrayLike) -> Floats:
        """Return where points, shape (k, 2), are mapped to, shape (k, 2)."""
        return _terms(np.asarray(points), self.centre, self.radius, self.degree) @ (
            self.coefficients
        )


def fit_map(points: ArrayLike, onto: ArrayLike, degree: int) -> PolynomialMap:
    """Return the polynomial map that brings points closest to others, by least squares.

    Args:
        points: shape (k, 2), more points than a polynomial of this degree has terms.
        onto: where each belongs, shape (k, 2).
        degree: total degree, 0 or more.

    Raises:
        MetrologyError: there are too few points.
    """
    points, onto = np.asarray(points, dtype=float), np.asarray(onto, dtype=float)
    terms = (degree + 1) * (degree + 2) // 2
    if len(points) < terms:
        raise MetrologyError(f"{len(points)} points do not fix a map of {terms} terms")
    centre = points.mean(axis=0)
    radius = float(np.hypot(*(points - centre).T).max()) or 1.0
    matrix = _terms(points, centre, radius, degree)
    coefficients = np.linalg.lstsq(matrix, onto, rcond=None)[0]
    return PolynomialMap(centre, radius, degree, coefficients)


def _terms(points: Floats, centre: Floats, radius: float, degree: int) -> Floats:
    x, y = ((points - centre) / radius).T
    return np.stack(
        [x**i * y ** (total - i) for total in range(degree + 1) for i in range(total + 1)], axis=1
    )
