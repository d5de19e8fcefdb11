# SPDX-License-Identifier: Apache-2.0
"""Segments of all joints: what motions in rad and s and motions in wire counts have in common."""

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_core.array_types import Ints, Mask, Offsets
from fiber_core.ragged import Parts

__all__ = ["JointSegments", "profile_rows"]


def profile_rows(rows: ArrayLike) -> Ints:
    """Return the profiles of robots: theta and phi of each, shape (2 k,).

    Args:
        rows: rows of the robots, shape (k,).
    """
    return (2 * np.asarray(rows, dtype=np.int64)[:, None] + np.array([0, 1])).ravel()


class JointSegments:
    """Constant-velocity segments of theta and phi of n robots, one after another.

    The segments of robot i, joint j (0 theta, 1 phi) are profile 2 i + j, the part
    ``offsets[2 i + j] : offsets[2 i + j + 1]`` of the flat arrays. The kinds of motion,
    SegmentMotion, WireMotion and CurveMotion, name these arrays.
    """

    start: NDArray[Any]
    offsets: Offsets

    _COLUMNS: ClassVar[tuple[str, ...]]  # names of the flat arrays, the duration of a segment first

    @property
    def n(self) -> int:
        """Number of robots."""
        return len(self.start)

    @property
    def parts(self) -> Parts:
        """The segments of each profile, as parts of the flat arrays."""
        return Parts(self.offsets)

    @property
    def counts(self) -> Ints:
        """Number of segments of each profile, shape (n, 2)."""
        return self.parts.counts.reshape(-1, 2)

    @property
    def moves(self) -> Mask:
        """Robots with at least one segment, shape (n,)."""
        return np.any(self.counts > 0, axis=1)

    def without(self, held: ArrayLike) -> Self:
        """Return the same motion with some robots resting at their start.

        Args:
            held: whether each robot rests, shape (n,).
        """
        parts, moves = self.parts.without(np.repeat(np.asarray(held, dtype=bool), 2))
        return self._made(self.start, parts, (column[moves] for column in self._columns))

    def only(self, chosen: ArrayLike) -> Self:
        """Return the same motion with all robots but some resting at their start.

        Args:
            chosen: whether each robot moves as before, shape (n,).
        """
        return self.without(~np.asarray(chosen, dtype=bool))

    def of_robots(self, rows: ArrayLike) -> Self:
        """Return the motion of some robots alone.

        Args:
            rows: rows of the robots, in the order of the result, shape (k,).
        """
        rows = np.asarray(rows, dtype=np.int64)
        parts, kept = self.parts.select(profile_rows(rows))
        return self._made(self.start[rows], parts, (column.take(kept) for column in self._columns))

    def with_robots(self, rows: ArrayLike, other: Self) -> Self:
        """Return the same motion with some robots moving, from the same start, in another way.

        Args:
            rows: rows of these robots, shape (k,).
            other: their motion, of k robots.
        """
        parts, kept = self.parts.replaced(profile_rows(rows), other.parts)
        both = (np.concatenate(columns) for columns in zip(self._columns, other._columns))
        return self._made(self.start, parts, (column.take(kept) for column in both))

    def _sums(self, values: NDArray[Any]) -> NDArray[Any]:
        # Each profile is summed by itself, in order: no robot's last digit depends on another.
        return self.parts.sums(values).reshape(-1, 2)

    @property
    def _columns(self) -> tuple[NDArray[Any], ...]:
        return tuple(getattr(self, name) for name in self._COLUMNS)

    def _shared(self) -> Mapping[str, object]:
        # fields that are neither start nor of the segments
        return {}

    def _made(self, start: NDArray[Any], parts: Parts, columns: Iterable[NDArray[Any]]) -> Self:
        # a motion of numbers of motions of this kind
        return self._unchecked(start, parts.offsets, columns, self._shared())

    @classmethod
    def _unchecked(
        cls,
        start: NDArray[Any],
        offsets: Offsets,
        columns: Iterable[NDArray[Any]],
        shared: Mapping[str, object],
    ) -> Self:
        # a motion of numbers that are known to be valid, made without the constructor's checks
        motion = object.__new__(cls)
        arrays = {"start": start, "offsets": offsets, **dict(zip(cls._COLUMNS, columns))}
        for array in arrays.values():
            array.setflags(write=False)
        vars(motion).update(shared, **arrays)
        return motion
