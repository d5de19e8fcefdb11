# SPDX-License-Identifier: Apache-2.0
"""What the project uses of astropy.table."""

from collections.abc import Iterator, Mapping, Sequence
from os import PathLike
from typing import IO, Any, overload

import numpy as np
from astropy.io.fits import BinTableHDU, TableHDU
from numpy.typing import NDArray

class _Unit:
    def to(self, other: str) -> float: ...

class Column(np.ndarray[Any, np.dtype[Any]]):
    """One column: an array, masked where values are missing, with a unit."""

    name: str
    @property
    def unit(self) -> _Unit | None: ...
    @unit.setter
    def unit(self, unit: _Unit | str | None) -> None: ...

class Table:
    """Columns of a file by name."""

    def __init__(self, columns: Mapping[str, NDArray[Any]] | None = ...) -> None: ...
    @classmethod
    def read(
        cls, path: str | PathLike[str] | BinTableHDU | TableHDU, *, format: str = ...
    ) -> Table: ...
    def write(self, path: IO[str] | IO[bytes] | str | PathLike[str], *, format: str) -> None: ...
    @property
    def colnames(self) -> list[str]: ...
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[Any]: ...
    @overload
    def __getitem__(self, item: str) -> Column: ...
    @overload
    def __getitem__(self, item: slice | Sequence[int] | NDArray[np.int64]) -> Table: ...
