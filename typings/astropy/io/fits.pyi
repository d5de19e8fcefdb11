# SPDX-License-Identifier: Apache-2.0
"""What the project uses of astropy.io.fits."""

from collections.abc import Iterator
from typing import IO

class _ColumnDefinition:
    name: str

class _HDU:
    name: str

class BinTableHDU(_HDU):
    @property
    def columns(self) -> list[_ColumnDefinition]: ...

class TableHDU(_HDU):
    @property
    def columns(self) -> list[_ColumnDefinition]: ...

class HDUList:
    def __enter__(self) -> HDUList: ...
    def __exit__(self, *error: object) -> None: ...
    def __iter__(self) -> Iterator[_HDU]: ...

def open(name: IO[bytes], *, memmap: bool = ...) -> HDUList: ...
