# SPDX-License-Identifier: Apache-2.0
"""The neighbours of each robot are those of its pairs, in a fixed order."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.clearance import most_neighbours, neighbours_of


@st.composite
def bodies_and_pairs(draw):
    bodies = draw(st.integers(2, 9))
    every = [(a, b) for a in range(bodies) for b in range(bodies) if a != b]
    pairs = st.lists(st.sampled_from(every), unique_by=frozenset, max_size=20)
    return bodies, draw(pairs)


@given(bodies_and_pairs(), st.integers(0, 9), st.booleans())
def test_every_robot_has_the_other_robot_of_each_of_its_pairs(drawn, robots, by_row):
    bodies, pairs = drawn
    robots = min(robots, bodies)
    near = neighbours_of(robots, pairs, by_row)
    columns = (near.parts.owner, near.body, near.pair, near.side)
    listed = sorted(zip(*(column.tolist() for column in columns)))
    expected = [(a, b, k, 0) for k, (a, b) in enumerate(pairs)]
    expected += [(b, a, k, 1) for k, (a, b) in enumerate(pairs)]
    assert listed == sorted(each for each in expected if each[0] < robots)
    assert near.parts.cover(robots, len(listed))
    assert most_neighbours(near) == near.parts.counts.max(initial=0)


@given(bodies_and_pairs())
def test_neighbours_are_in_the_order_of_the_pairs_or_of_the_rows(drawn):
    bodies, pairs = drawn
    for by_row in (False, True):
        near = neighbours_of(bodies, pairs, by_row)
        for robot in range(bodies):
            first = [b for a, b in pairs if a == robot]
            second = [a for a, b in pairs if b == robot]
            expected = sorted(first + second) if by_row else first + second
            assert near.body[near.parts.slice(robot)].tolist() == expected


@given(bodies_and_pairs(), st.data())
def test_neighbours_by_place_do_not_depend_on_the_order_of_rows_and_pairs(drawn, data):
    bodies, pairs = drawn
    spots = [(float(x), float(y)) for x in range(3) for y in range(3)]
    places = np.array(data.draw(st.permutations(spots)))[:bodies]
    near = neighbours_of(bodies, pairs, places=places)
    for robot in range(bodies):
        own = places[near.body[near.parts.slice(robot)]].tolist()
        assert own == sorted(own)
    order = np.array(data.draw(st.permutations(range(bodies))))
    renamed = data.draw(st.permutations([(order[a], order[b]) for a, b in pairs]))
    moved = np.empty_like(places)
    moved[order] = places
    other = neighbours_of(bodies, np.array(renamed).reshape(-1, 2), places=moved)
    for robot in range(bodies):
        own = near.body[near.parts.slice(robot)]
        assert np.array_equal(other.body[other.parts.slice(order[robot])], order[own])


@pytest.mark.parametrize("places", [None, np.zeros((3, 2))])
def test_without_pairs_no_robot_has_a_neighbour(places):
    near = neighbours_of(3, np.zeros((0, 2), dtype=np.int64), places=places)
    assert near.offsets.tolist() == [0, 0, 0, 0] and most_neighbours(near) == 0
    assert len(near.body) == len(near.pair) == len(near.side) == 0
