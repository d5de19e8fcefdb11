# SPDX-License-Identifier: Apache-2.0
"""The share of each sector: which buses of a plane it drives."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Ints
from fiber_core.focal_plane import FocalPlane
from fiber_sectors.errors import SectorError

__all__ = ["part_of", "sector_of_buses", "with_sectors"]


def sector_of_buses(buses: ArrayLike, shares: str) -> Ints:
    """Return the sector of each bus, from 0.

    Args:
        buses: the bus numbers, increasing, shape (b,).
        shares: a number of sectors, each with as many buses in a row as the others or one more; or
            the buses of each sector, as "0-3,8; 4-7; 9".

    Raises:
        SectorError: the text is no such table, or a bus has no sector, or two; names it.
    """
    numbers = np.asarray(buses, dtype=np.int64)
    if shares.strip().isdigit():
        k = int(shares)
        if not 1 <= k <= len(numbers):
            raise SectorError(f"{k} sectors for {len(numbers)} buses: each needs a bus")
        return np.arange(len(numbers)) * k // len(numbers)
    sector = np.full(len(numbers), -1)
    for k, part in enumerate(shares.split(";")):
        for first, last in _ranges(part, shares):
            mine = (numbers >= first) & (numbers <= last)
            if (sector[mine] >= 0).any():
                bus = numbers[mine & (sector >= 0)][0]
                raise SectorError(f"bus {bus} is in two sectors of {shares!r}")
            if not mine.any():
                raise SectorError(f"sector {k} of {shares!r}: the plane has no bus {first}..{last}")
            sector[mine] = k
    if (sector < 0).any():
        raise SectorError(f"bus {numbers[sector < 0][0]} is in no sector of {shares!r}")
    return sector


def _ranges(part: str, shares: str) -> list[tuple[int, int]]:
    found = []
    for each in part.split(","):
        first, dash, last = (text.strip() for text in each.partition("-"))
        if not first.isdigit() or (dash and not last.isdigit()):
            raise SectorError(
                f"sectors {shares!r}: {each.strip()!r} is neither a bus nor a range as 0-3"
            )
        found.append((int(first), int(last if dash else first)))
    return found


def with_sectors(plane: FocalPlane, shares: str) -> FocalPlane:
    """Return a plane with its robots in the sectors of their buses.

    Raises:
        SectorError: as of sector_of_buses.
    """
    buses, place = np.unique(plane.bus, return_inverse=True)
    return replace(plane, sector=sector_of_buses(buses, shares)[place])


def part_of(plane: FocalPlane, sector: int) -> FocalPlane:
    """Return the robots of one sector as a plane, with their ids.

    Raises:
        SectorError: the plane has no such sector.
    """
    rows = np.flatnonzero(plane.sector == sector)
    if len(rows) == 0:
        raise SectorError(f"there is no sector {sector}, only 0..{plane.sector.max(initial=0)}")
    return replace(plane.permuted(rows), ids=plane.ids[rows])
