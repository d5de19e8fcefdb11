# SPDX-License-Identifier: Apache-2.0
"""Names of array types that state the shape and the unit of an array.

In the shapes, n stands for all robots, k for some of them, p for pairs, m for segments and t for
instants. A type checker sees the kind of the elements; `fiber_core.validation` checks shapes
where data enters. An argument that is converted with np.asarray takes numpy's ``ArrayLike``.

numpy's stubs give ``array.any(axis=1)`` a type that may be a single number, and
``np.any(array, axis=1)`` one that fits these names: the latter is used where it matters.
"""

from typing import Annotated, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Angles",
    "Bools",
    "Codes",
    "Counts",
    "Floats",
    "Gaps",
    "Ids",
    "Ints",
    "Mask",
    "Offsets",
    "Pairs",
    "Points",
    "Rows",
    "Times",
    "Velocities",
]

Floats: TypeAlias = NDArray[np.floating[Any]]
Ints: TypeAlias = NDArray[np.integer[Any]]  # rows are np.intp, another type to checkers
Bools: TypeAlias = NDArray[np.bool_]

Angles = Annotated[Floats, "joint angles theta, phi [rad], shape (n, 2)"]
Velocities = Annotated[Floats, "joint velocities [rad/s], shape (n, 2)"]
Points = Annotated[Floats, "points in the focal plane [mm], shape (n, 2)"]
Times = Annotated[Floats, "instants [s], shape (t,)"]
Gaps = Annotated[Floats, "gaps between outlines [mm], shape (p,)"]
Counts = Annotated[Ints, "encoder counts theta, phi [quanta], shape (n, 2)"]
Ids = Annotated[Ints, "robot ids, shape (n,)"]
Rows = Annotated[Ints, "rows of robots in their plane, shape (k,)"]
Pairs = Annotated[Ints, "rows of two robots each, shape (p, 2)"]
Offsets = Annotated[Ints, "first element of each part of a flat array, shape (parts + 1,)"]
Codes = Annotated[Ints, "members of an enumeration as numbers, shape (n,)"]
Mask = Annotated[Bools, "whether each robot is meant, shape (n,)"]
