# SPDX-License-Identifier: Apache-2.0
"""What the project uses of scipy.spatial."""

from typing import Any, Literal, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

class cKDTree:
    """Search tree over points, shape (n, m)."""

    def __init__(self, data: ArrayLike) -> None: ...
    @overload
    def query_pairs(self, r: float, *, output_type: Literal["ndarray"]) -> NDArray[np.int64]: ...
    @overload
    def query_pairs(
        self, r: float, *, output_type: Literal["set"] = ...
    ) -> set[tuple[int, int]]: ...
    # one list of rows for each point of x, shape (k, m)
    def query_ball_point(self, x: ArrayLike, r: ArrayLike) -> NDArray[np.object_]: ...
    # distances and rows, both of shape (k,) for one neighbour or (k, neighbours)
    def query(
        self, x: ArrayLike, k: int = ..., *, distance_upper_bound: float = ...
    ) -> tuple[NDArray[Any], NDArray[Any]]: ...

class ConvexHull:
    """Convex hull of points, shape (n, m)."""

    def __init__(self, points: ArrayLike) -> None: ...
    @property
    def vertices(self) -> NDArray[np.int32]: ...

class Delaunay:
    """Delaunay triangulation of points, shape (n, 2)."""

    def __init__(self, points: ArrayLike) -> None: ...
    @property
    def simplices(self) -> NDArray[np.int32]: ...
