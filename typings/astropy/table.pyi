"""What the project uses of astropy.table."""

from collections.abc import Iterator, Sequence
from os import PathLike
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

class _Unit:
    def to(self, other: str) -> float: ...

class Column(np.ndarray[Any, np.dtype[Any]]):
    """One column: an array, masked where values are missing, with a unit."""

    unit: _Unit | None

class Table:
    """Columns of a file by name."""

    @classmethod
    def read(cls, path: str | PathLike[str], *, format: str) -> Table: ...
    @property
    def colnames(self) -> list[str]: ...
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[Any]: ...
    @overload
    def __getitem__(self, item: str) -> Column: ...
    @overload
    def __getitem__(self, item: slice | Sequence[int] | NDArray[np.int64]) -> Table: ...
