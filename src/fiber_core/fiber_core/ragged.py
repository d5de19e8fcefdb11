# SPDX-License-Identifier: Apache-2.0
"""Ragged arrays: parts of different lengths, one after another in a flat array.

The segments of all profiles, the bytes of all frames and the knots of all polylines are stored
in this way. `Parts` has the arithmetic of the offsets; the flat arrays stay plain numpy arrays.
Compiled loops take the offsets themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_core.array_types import Bools, Ints, Offsets

__all__ = ["Parts"]

_Kind = TypeVar("_Kind", bound=np.generic)


@dataclass(frozen=True, eq=False)
class Parts:
    """Where the parts of a flat array begin: part i is ``offsets[i] : offsets[i + 1]``.

    The offsets are taken as they are; `cover` checks those that come from elsewhere.

    Args:
        offsets: first element of each part, and the number of elements, shape (p + 1,).
    """

    offsets: Offsets

    @classmethod
    def from_counts(cls, counts: ArrayLike) -> "Parts":
        """Return parts of given lengths.

        Args:
            counts: number of elements of each part; an array of any shape is read row by row.
        """
        counts = np.asarray(counts)
        offsets = np.zeros(counts.size + 1, dtype=np.int64)
        np.cumsum(counts, dtype=np.int64, out=offsets[1:])
        return cls(offsets)

    @classmethod
    def from_owners(cls, owners: ArrayLike, parts: int) -> "Parts":
        """Return the parts of a flat array that is sorted by the part of each element.

        Args:
            owners: the part to which each element belongs, ascending, shape (m,).
            parts: number of parts.
        """
        return cls(np.searchsorted(np.asarray(owners), np.arange(parts + 1)))

    @classmethod
    def concatenate(cls, parts: Sequence["Parts"]) -> "Parts":
        """Return the parts of flat arrays that are joined in this order."""
        return cls.from_counts(np.concatenate([np.zeros(0, np.int64), *(p.counts for p in parts)]))

    def __len__(self) -> int:
        """Return the number of parts."""
        return len(self.offsets) - 1

    @property
    def total(self) -> int:
        """Number of elements of all parts."""
        return int(self.offsets[-1])

    @property
    def first(self) -> Ints:
        """First element of each part, shape (p,)."""
        return self.offsets[:-1]

    @property
    def counts(self) -> Ints:
        """Number of elements of each part, shape (p,)."""
        return np.diff(self.offsets)

    @property
    def owner(self) -> Ints:
        """The part to which each element belongs, shape (m,)."""
        return np.repeat(np.arange(len(self)), self.counts)

    def cover(self, parts: int, total: int) -> bool:
        """Return whether the offsets rise from 0 to `total` and make so many parts.

        Args:
            parts: expected number of parts.
            total: length of the flat array.
        """
        return bool(
            self.offsets.shape == (parts + 1,)
            and self.offsets[0] == 0
            and self.offsets[-1] == total
            and np.all(self.counts >= 0)
        )

    def slice(self, part: int) -> slice:
        """Return the elements of one part."""
        return slice(int(self.offsets[part]), int(self.offsets[part + 1]))

    def select(self, parts: ArrayLike) -> tuple["Parts", Ints]:
        """Return some parts, in the given order, and the elements that they consist of.

        Args:
            parts: the chosen parts, shape (s,); a part may occur several times.

        Returns:
            The chosen parts, and for each of their elements its index in the present flat array.
        """
        parts = np.asarray(parts, dtype=np.int64)
        return Parts.gather(self.offsets[parts], self.offsets[parts + 1] - self.offsets[parts])

    @classmethod
    def gather(cls, first: Ints, counts: Ints) -> tuple["Parts", Ints]:
        """Return parts that are runs of a flat array, and the elements that they consist of.

        Args:
            first: element at which each run begins, shape (s,).
            counts: number of elements of each run, shape (s,).

        Returns:
            The parts, and for each of their elements its index in the flat array.
        """
        gathered = cls.from_counts(counts)
        return gathered, _elements(gathered.offsets, np.asarray(first, dtype=np.int64))

    def sums(self, values: NDArray[_Kind]) -> NDArray[_Kind]:
        """Return the sum of the values of each part, added in their order, shape (p,).

        Args:
            values: a flat array, shape (m,).
        """
        return _running(self.offsets, values)[self.offsets[1:] + np.arange(len(self))]

    def before(self, values: NDArray[_Kind]) -> NDArray[_Kind]:
        """Return the sum of the values before each element in its part, shape (m,).

        It is exactly the sum up to the end of the element before it.

        Args:
            values: a flat array, shape (m,).
        """
        return _running(self.offsets, values)[np.arange(self.total) + self.owner]

    @property
    def knots(self) -> "Parts":
        """Parts with one element more than these: the knots at the ends of their elements."""
        return Parts(self.offsets + np.arange(len(self.offsets)))

    def running(self, values: NDArray[_Kind]) -> NDArray[_Kind]:
        """Return the running sums of each part, 0 first and its whole sum last, at its `knots`.

        Args:
            values: a flat array, shape (m,).

        Returns:
            The sums, shape (m + p,).
        """
        return _running(self.offsets, values)

    def replaced(self, parts: ArrayLike, by: "Parts") -> tuple["Parts", Ints]:
        """Return the same number of parts, some of them taken from another flat array.

        Args:
            parts: the parts that are replaced, each once, shape (s,).
            by: the parts of the other array that replace them, s parts in the same order.

        Returns:
            The parts, and for each of their elements its index in the present flat array with
            the other one appended.
        """
        parts = np.asarray(parts, dtype=np.int64)
        first, counts = self.first.copy(), self.counts
        first[parts], counts[parts] = by.first + self.total, by.counts
        return Parts.gather(first, counts)

    def without(self, empty: ArrayLike) -> tuple["Parts", Bools]:
        """Return the same number of parts, some of them emptied, and the elements that remain.

        Args:
            empty: whether each part loses its elements, shape (p,).

        Returns:
            The parts, and whether each element of the present flat array remains.
        """
        empty, counts = np.asarray(empty, dtype=bool), self.counts
        return Parts.from_counts(np.where(empty, 0, counts)), np.repeat(~empty, counts)


@nb.njit(cache=True)
def _elements(offsets: Offsets, first: Ints) -> Ints:
    # where the elements of parts stand that begin at `first` in another flat array
    elements = np.empty(offsets[-1], dtype=np.int64)
    for part in range(len(first)):
        for k in range(offsets[part], offsets[part + 1]):
            elements[k] = first[part] + (k - offsets[part])
    return elements


@nb.njit(cache=True)
def _running(offsets: Offsets, values: NDArray[Any]) -> NDArray[Any]:
    # the sums of the values of each part up to each element: one element more than the part
    sums = np.empty(len(values) + len(offsets) - 1, dtype=values.dtype)
    for part in range(len(offsets) - 1):
        at = offsets[part] + part
        total = values.dtype.type(0)
        sums[at] = total
        for k in range(offsets[part], offsets[part + 1]):
            total += values[k]
            sums[k + part + 1] = total
    return sums
