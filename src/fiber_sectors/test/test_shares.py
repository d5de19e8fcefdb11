# SPDX-License-Identifier: Apache-2.0
"""The buses of each sector."""

import numpy as np
import pytest

from fiber_core.presets import preset
from fiber_sectors import SectorError
from fiber_sectors.shares import part_of, sector_of_buses, with_sectors


@pytest.mark.parametrize(
    ("shares", "sector"),
    [
        ("1", [0] * 7),
        ("3", [0, 0, 0, 1, 1, 2, 2]),
        ("7", list(range(7))),
        ("0-2,9; 4, 5; 11-20", [0, 0, 0, 1, 1, 0, 2]),
    ],
)
def test_buses_are_shared_out(shares, sector):
    np.testing.assert_array_equal(sector_of_buses([0, 1, 2, 4, 5, 9, 12], shares), sector)


@pytest.mark.parametrize(
    ("shares", "text"),
    [
        ("0", "0 sectors for 3 buses"),
        ("4", "4 sectors for 3 buses"),
        ("0;1", "bus 2 is in no sector"),
        ("0-1;1-2", "bus 1 is in two sectors"),
        ("0-2;7", "no bus 7..7"),
        ("a;b", "'a' is neither"),
        ("0-2;", "'' is neither"),
    ],
)
def test_a_table_that_does_not_fit_is_refused(shares, text):
    with pytest.raises(SectorError, match=text):
        sector_of_buses([0, 1, 2], shares)


def test_the_parts_are_the_plane():
    plane = with_sectors(preset("desi", 1200), "3")
    parts = [part_of(plane, k) for k in range(3)]
    np.testing.assert_array_equal(np.concatenate([part.ids for part in parts]), plane.ids)
    for name in ("centers", "limits", "bus", "address"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(plane, name))
    with pytest.raises(SectorError, match="no sector 3"):
        part_of(plane, 3)
