"""The neighbours of each robot are those of its pairs, in a fixed order."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.clearance import neighbours_of
from fiber_core.ragged import Parts


@st.composite
def bodies_and_pairs(draw):
    bodies = draw(st.integers(2, 9))
    every = [(a, b) for a in range(bodies) for b in range(a + 1, bodies)]
    return bodies, draw(st.lists(st.sampled_from(every), unique=True, max_size=20))


@given(bodies_and_pairs(), st.integers(0, 9), st.booleans())
def test_every_robot_has_the_other_robot_of_each_of_its_pairs(drawn, robots, by_row):
    bodies, pairs = drawn
    robots = min(robots, bodies)
    near = neighbours_of(robots, pairs, by_row)
    own = Parts(near.offsets).owner
    listed = sorted(zip(own.tolist(), near.body.tolist(), near.pair.tolist()))
    expected = [(a, b, k) for k, (a, b) in enumerate(pairs)]
    expected += [(b, a, k) for k, (a, b) in enumerate(pairs)]
    assert listed == sorted(each for each in expected if each[0] < robots)
    assert len(near.offsets) == robots + 1


@given(bodies_and_pairs())
def test_neighbours_are_in_the_order_of_the_pairs_or_of_the_rows(drawn):
    bodies, pairs = drawn
    for by_row in (False, True):
        near = neighbours_of(bodies, pairs, by_row)
        parts = Parts(near.offsets)
        for robot in range(bodies):
            first = [b for a, b in pairs if a == robot]
            second = [a for a, b in pairs if b == robot]
            expected = sorted(first + second) if by_row else first + second
            assert near.body[parts.slice(robot)].tolist() == expected


def test_without_pairs_no_robot_has_a_neighbour():
    near = neighbours_of(3, np.zeros((0, 2), dtype=np.int64))
    assert near.offsets.tolist() == [0, 0, 0, 0] and len(near.body) == len(near.pair) == 0
