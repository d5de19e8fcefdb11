"""Names for arrays that tell what they hold: shape and unit.

n robots, k some of them, p pairs, m segments, t instants. They are for readers and for type
checkers, which see the element type; shapes are checked once, where data enters.
"""

from typing import Annotated, TypeAlias

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

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
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
