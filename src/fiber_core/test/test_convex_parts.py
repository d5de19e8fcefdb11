# SPDX-License-Identifier: Apache-2.0
"""Polygons as convex parts: the parts are convex and cover the polygon once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core import LayoutError
from fiber_core.convex_parts import convex_parts
from fiber_core.walls import checked_walls, padded_walls

L_SHAPE = [[0, 0], [3, 0], [3, 1], [1, 1], [1, 2], [0, 2]]


def area(polygon):
    x, y = (polygon - polygon[0]).T
    return 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))


def inside(polygon, points):
    # even-odd rule along a ray to the right
    odd = np.zeros(len(points), dtype=bool)
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0)):
        across = (y0 > points[:, 1]) != (y1 > points[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            x = x0 + (points[:, 1] - y0) * (x1 - x0) / (y1 - y0)
        odd ^= across & (points[:, 0] < x)
    return odd


@given(
    radii=st.lists(st.floats(0.2, 5.0), min_size=3, max_size=14),
    seed=st.integers(0, 2**32),
    turned=st.booleans(),
)
def test_parts_cover_a_star_shaped_polygon_once(radii, seed, turned):
    rng = np.random.default_rng(seed)
    steps = 1.0 + rng.random(len(radii))
    angles = np.cumsum(steps) / steps.sum() * 2 * np.pi
    star = np.array(radii)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    parts = convex_parts(star[::-1] if turned else star)
    checked_walls(padded_walls(parts))  # convex
    assert all(area(part) > 0 for part in parts)
    assert sum(area(part) for part in parts) == pytest.approx(area(star), rel=1e-9)
    points = rng.uniform(-5, 5, (200, 2))
    count = sum(inside(part, points).astype(int) for part in parts)
    assert np.array_equal(count, inside(star, points).astype(int))


def test_an_l_is_two_parts_and_a_convex_polygon_is_one():
    assert [len(part) for part in convex_parts(L_SHAPE)] in ([4, 4], [5, 4], [4, 5])
    square = [[0, 0], [1, 0], [2, 0], [2, 2], [0, 2], [0, 0]]  # a straight corner, closed
    (part,) = convex_parts(square)
    assert area(part) == 4.0


@pytest.mark.parametrize(
    "outline",
    [
        [[0, 0], [2, 1], [4, 0], [4, 3], [2, 1], [0, 3]],
        [[0, 0], [10, 0], [10, 4], [5, 1], [7, 4], [3, 4], [5, 1], [0, 4]],
    ],
)
def test_an_outline_may_touch_itself_at_a_corner(outline):
    points = np.random.default_rng(5).uniform(0, 10, (400, 2))
    for first in range(len(outline)):
        turned = np.roll(np.array(outline, dtype=float), first, axis=0)
        for polygon in (turned, turned[::-1]):
            parts = convex_parts(polygon)
            checked_walls(padded_walls(parts))
            count = sum(inside(part, points).astype(int) for part in parts)
            assert np.array_equal(count, inside(turned, points).astype(int))


def test_points_and_lines_are_themselves():
    assert convex_parts([[1, 2], [1, 2]])[0].tolist() == [[1, 2]]
    assert convex_parts([[1, 2], [3, 4], [1, 2]])[0].tolist() == [[1, 2], [3, 4]]


def test_a_polygon_that_crosses_itself_is_refused():
    with pytest.raises(LayoutError, match="crosses itself"):
        convex_parts([[0, 0], [4, 0], [1, 3], [1, -3], [4, 3]])
    with pytest.raises(LayoutError, match="crosses itself"):
        convex_parts([[0, 0], [1, 0], [2, 0]])  # there and back
