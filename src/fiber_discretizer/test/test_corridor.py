import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.clearance import bodies_of, neighbour_pairs, profiles_of, sampled_gaps
from fiber_core.motion import SegmentMotion
from fiber_discretizer.corridor import free_corridors, neighbours_of

REQUIRED_MM = 0.1
TRIANGLE = [[0.0, 0.0], [10.4, 0.0], [5.2, 9.0]]
REACH_RAD = 1.6
SAMPLES = 25


def random_motion(rng, n):
    counts = rng.integers(0, 4, 2 * n)
    offsets = np.concatenate([[0], np.cumsum(counts)])
    start = rng.uniform([-3.0, 0.3], [3.0, 2.8], (n, 2))
    speeds = rng.uniform(-0.6, 0.6, offsets[-1])
    return SegmentMotion(start, offsets, rng.uniform(0.1, 0.6, offsets[-1]), speeds)


def walls(plane, motion, joint, side, wish=None):
    """Walls of robot 0 beside the others, by default around its own motion."""
    times = np.linspace(0.0, 1.5, SAMPLES)[None]
    angles = np.stack([motion(t) for t in times[0]], axis=-1)
    wish = angles[:1] if wish is None else wish
    pairs = neighbour_pairs(plane)
    levers = np.stack([plane.reach_mm, plane.arms[:, 1] + plane.phi_radius], axis=1)
    low, high, is_open = free_corridors(
        bodies_of(plane).table,
        levers,
        plane.limits,
        profiles_of(motion),
        neighbours_of(plane.n, pairs),
        np.full(len(pairs), REQUIRED_MM),
        np.array([0]),
        joint,
        times,
        wish,
        side,
        REACH_RAD,
    )
    return angles, low[0], high[0], bool(is_open[0])


def least_room(plane, angles, joint, mine):
    """Least gap of robot 0 to the others minus the gap required, at each sample, (t,)."""
    changed = angles.copy()
    changed[0, joint] = mine
    pairs = neighbour_pairs(plane)
    own = pairs[(pairs == 0).any(axis=1)]
    return sampled_gaps(plane, own, changed).min(axis=0) - REQUIRED_MM


@given(
    seed=st.integers(0, 2**32 - 1),
    joint=st.sampled_from([0, 1]),
    side=st.sampled_from([-1, 0, 1]),
)
def test_between_the_walls_of_an_open_tube_nobody_is_touched(plane_at, seed, joint, side):
    rng = np.random.default_rng(seed)
    plane = plane_at(TRIANGLE, obstacles=[[-4.0, 5.0, 1.5]])
    angles, low, high, is_open = walls(plane, random_motion(rng, 3), joint, side)
    if not is_open:
        assert side != 0 or least_room(plane, angles, joint, angles[0, joint]).min() < 0.0
        return
    assert np.all(low <= high)
    assert np.all((low >= plane.limits[0, joint, 0]) & (high <= plane.limits[0, joint, 1]))
    assert low[0] <= angles[0, joint, 0] <= high[0]
    assert low[-1] <= angles[0, joint, -1] <= high[-1]
    for part in (0.0, 0.3, 0.5, 0.8, 1.0):
        mine = low + part * (high - low)
        assert least_room(plane, angles, joint, mine).min() >= -1e-9
    if side:  # neighbouring instants are on the same side of whatever is in the way
        assert np.all(low[1:] <= high[:-1]) and np.all(high[1:] >= low[:-1])


@given(seed=st.integers(0, 2**32 - 1), joint=st.sampled_from([0, 1]))
def test_walls_are_where_somebody_is_or_as_far_as_asked(plane_at, seed, joint):
    rng = np.random.default_rng(seed)
    plane = plane_at(TRIANGLE)
    angles, low, high, is_open = walls(plane, random_motion(rng, 3), joint, 0)
    if not is_open:
        return
    limits = plane.limits[0, joint]
    for wall, way in ((low, -1), (high, 1)):
        gone = way * (wall - angles[0, joint])
        far = (gone > REACH_RAD - 1e-9) | (np.abs(wall - limits[(way + 1) // 2]) < 1e-9)
        # 0.05 rad farther somebody is closer than 0.15 mm more than required
        beside = least_room(plane, angles, joint, wall + way * 0.05)
        near = np.minimum(beside, least_room(plane, angles, joint, wall)) < 0.15
        assert np.all(far | near)


@pytest.mark.parametrize("side", [1, -1])
def test_a_tube_goes_around_what_is_in_the_way(plane_at, side):
    # A disc that a stretched arm meets halfway; folding takes the tip past it.
    limits = [[[-5.0, 5.0], [-np.pi, np.pi]]]
    plane = plane_at([[0.0, 0.0]], obstacles=[[6.0, 0.0, 0.8]], limits=limits)
    start = np.array([[-1.5, 0.0]])
    motion = SegmentMotion(start, [0, 1, 1], [1.5], [2.0])
    angles, low, high, is_open = walls(plane, motion, 1, side)
    assert is_open
    middle = slice(SAMPLES // 2 - 1, SAMPLES // 2 + 2)
    assert np.all(side * (low + high)[middle] > 0.0)  # folded to that side when it is there
    assert low[0] <= 0.0 <= high[0] and low[-1] <= 0.0 <= high[-1]
    assert not walls(plane, motion, 1, 0)[3]


def test_robots_without_neighbours_have_all_the_reach(plane_at):
    plane = plane_at([[0.0, 0.0], [100.0, 0.0]])
    motion = SegmentMotion.at_rest([[0.0, 1.5], [0.0, 1.5]])
    _, low, high, is_open = walls(plane, motion, 0, 0)
    assert is_open
    np.testing.assert_allclose(high, REACH_RAD)
    np.testing.assert_allclose(low, -REACH_RAD)
