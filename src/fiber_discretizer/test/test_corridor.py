# SPDX-License-Identifier: Apache-2.0
"""Corridors and free intervals: free of neighbours inside, and as wide as that allows."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.clearance import (
    bodies_of,
    levers_of,
    neighbour_pairs,
    neighbours_of,
    sampled_gaps,
)
from fiber_core.motion import SegmentMotion
from fiber_core.presets import preset
from fiber_core.ragged import Parts
from fiber_discretizer.corridor import (
    FINEST_RAD,
    Task,
    free_intervals,
    keep_inside,
    open_corridors,
)
from fiber_discretizer.tracing import pose_bodies, turn_from

REQUIRED_MM = 0.1
TRIANGLE = [[0.0, 0.0], [10.4, 0.0], [5.2, 9.0]]
REACH_RAD = 1.6
SAMPLES = 25


def random_motion(rng, n):
    counts = rng.integers(0, 4, 2 * n)
    offsets = Parts.from_counts(counts).offsets
    start = rng.uniform([-3.0, 0.3], [3.0, 2.8], (n, 2))
    speeds = rng.uniform(-0.6, 0.6, offsets[-1])
    return SegmentMotion(start, offsets, rng.uniform(0.1, 0.6, offsets[-1]), speeds)


def task_of(plane, motion, rows, joint):
    """A joint of some robots among the others, and the angles of all robots at the samples."""
    times = np.linspace(0.0, 1.5, SAMPLES)
    angles = np.stack([motion(t) for t in times], axis=-1)
    pairs = neighbour_pairs(plane)
    task = Task(
        table=bodies_of(plane).table,
        levers=levers_of(plane),
        limits=plane.limits,
        motion=motion.arrays,
        neighbours=neighbours_of(plane.n, pairs),
        required=np.full(len(pairs), REQUIRED_MM),
        rows=np.array(rows),
        joint=joint,
        times=np.tile(times, (len(rows), 1)),
        desired=angles[rows],
        reach=REACH_RAD,
    )
    return task, angles


def bounds(plane, motion, joint, side):
    """Bounds of a joint of robot 0 among the others, around its own motion, all traced."""
    task, angles = task_of(plane, motion, [0], joint)
    corridors = open_corridors(task, side)
    for w in range(2):
        keep_inside(task, corridors, task.rows, corridors.bounds[w].copy(), 0.0)
    np.testing.assert_array_equal(corridors.free, corridors.bounds)
    return angles, *corridors.bounds[:, 0], bool(corridors.is_open[0])


def intervals(plane, motion, joint):
    """Free intervals of a joint of robot 0 among the others."""
    task, angles = task_of(plane, motion, np.arange(plane.n), joint)
    low, high = free_intervals(task)
    return angles, low[0], high[0]


def least_spare_gap(plane, angles, joint, turned):
    """Least gap of robot 0 to the others less the required gap at each sample, shape (t,)."""
    changed = angles.copy()
    changed[0, joint] = turned
    pairs = neighbour_pairs(plane)
    own = pairs[(pairs == 0).any(axis=1)]
    return sampled_gaps(plane, own, changed).min(axis=0) - REQUIRED_MM


@given(
    seed=st.integers(0, 2**32 - 1),
    joint=st.sampled_from([0, 1]),
    side=st.sampled_from([-1, 0, 1]),
)
def test_a_joint_between_the_bounds_touches_no_neighbour(plane_at, seed, joint, side):
    rng = np.random.default_rng(seed)
    plane = plane_at(TRIANGLE, obstacles=[[-4.0, 5.0, 1.5]])
    angles, low, high, is_open = bounds(plane, random_motion(rng, 3), joint, side)
    if not is_open:  # the intervals of a joint at rest overlap in its angle
        unsafe = least_spare_gap(plane, angles, joint, angles[0, joint]).min() < 1e-9
        assert side != 0 or np.ptp(angles[0, joint]) > 0.0 or unsafe
        return
    assert np.all(low <= high)
    assert np.all((low >= plane.limits[0, joint, 0]) & (high <= plane.limits[0, joint, 1]))
    assert low[0] <= angles[0, joint, 0] <= high[0]
    assert low[-1] <= angles[0, joint, -1] <= high[-1]
    for part in (0.0, 0.3, 0.5, 0.8, 1.0):
        turned = low + part * (high - low)
        assert least_spare_gap(plane, angles, joint, turned).min() >= -1e-9


@given(seed=st.integers(0, 2**32 - 1), joint=st.sampled_from([0, 1]))
def test_a_free_interval_ends_at_a_neighbour_at_a_limit_or_at_the_full_reach(plane_at, seed, joint):
    plane = plane_at(TRIANGLE, obstacles=[[-4.0, 5.0, 1.5]])
    motion = random_motion(np.random.default_rng(seed), 3)
    angles, low, high = intervals(plane, motion, joint)
    turned, (bottom, top) = angles[0, joint], plane.limits[0, joint]
    spare = least_spare_gap(plane, angles, joint, turned)
    free = (spare >= 0.0) & (bottom <= turned) & (turned <= top)
    sure = np.abs(spare) > 1e-9
    assert np.all((low == turned)[~free & sure] & (high == turned)[~free & sure])
    nearest = FINEST_RAD * levers_of(plane)[0, joint] + 1e-9
    for end, limit, way in ((low, bottom, -1), (high, top, 1)):
        gap = least_spare_gap(plane, angles, joint, end)
        full = way * (end - turned) > REACH_RAD - 1e-9
        assert np.all(gap[free & sure] >= -1e-9)
        assert np.all((full | (np.abs(end - limit) < 1e-9) | (gap < nearest))[free & sure])


@given(seed=st.integers(0, 2**32 - 1), joint=st.sampled_from([0, 1]))
def test_a_joint_is_free_between_the_ends_of_its_interval(plane_at, seed, joint):
    plane = plane_at(TRIANGLE, obstacles=[[-4.0, 5.0, 1.5]])
    motion = random_motion(np.random.default_rng(seed), 3)
    angles, low, high = intervals(plane, motion, joint)
    wide = high > low
    for part in np.linspace(0.0, 1.0, 9):
        turned = low + part * (high - low)
        assert np.all(least_spare_gap(plane, angles, joint, turned)[wide] >= -1e-9)


def plain_interval(task, row, k):
    """The ends of the interval of one robot at one sample, with all of its neighbours."""
    near = slice(*task.neighbours.offsets[row : row + 2])
    bodies, required = task.neighbours.body[near], task.required[task.neighbours.pair[near]]
    poses = np.empty((len(bodies), 4))
    pose_bodies(task.motion, bodies, task.times[row, k], poses)
    scene = (task.table, row, bodies, required, poses, np.empty((2, len(bodies))))
    here, (bottom, top) = task.desired[row, task.joint, k], task.limits[row, task.joint]
    ends = [max(bottom, here - task.reach), min(top, here + task.reach)]
    axis = (task.joint, task.levers[row, task.joint], bottom, top, 1 << 30)
    if not ends[0] <= here <= ends[1]:
        return here, here
    angles = task.desired[row, :, k].copy()
    for w, way in enumerate((-1, 1)):
        reach = way * (ends[w] - here)
        turned = turn_from(scene, axis, angles, here, way, reach)
        if (scene[5][0] < 0.0).any() and turned <= 0.0:  # not free from the start
            return here, here
        ends[w] = here + way * turned if turned < reach else ends[w]
    return tuple(ends)


@pytest.mark.parametrize("outlines", [False, True])
@pytest.mark.parametrize("joint", [0, 1])
def test_neighbours_out_of_reach_change_no_interval(outlines, joint):
    obstacles = [[-4.0, 5.0, 0.3], [5.2, 3.0, 0.5]]
    plane = replace(preset("desi_outlines" if outlines else "desi", 7), obstacles=obstacles)
    task, _ = task_of(plane, random_motion(np.random.default_rng(5), 7), np.arange(7), joint)
    low, high = free_intervals(task)
    plain = [[plain_interval(task, row, k) for k in range(SAMPLES)] for row in range(7)]
    np.testing.assert_array_equal(np.stack([low, high], axis=-1), plain)
    assert (high > low).any() and (high == low).any()
    assert (high - low < 2 * REACH_RAD - 1e-9).mean() > 0.1


@given(
    seed=st.integers(0, 2**32 - 1),
    joint=st.sampled_from([0, 1]),
    side=st.sampled_from([-1, 0, 1]),
)
def test_a_path_inside_is_free_and_a_path_outside_meets_a_traced_bound(plane_at, seed, joint, side):
    rng = np.random.default_rng(seed)
    plane = plane_at(TRIANGLE, obstacles=[[-4.0, 5.0, 1.5]])
    task, angles = task_of(plane, random_motion(rng, 3), [0], joint)
    corridors = open_corridors(task, side)
    if not corridors.is_open[0]:
        return
    low, high = corridors.bounds[:, 0].copy()
    paths = low + rng.random() * (high - low)
    inside = keep_inside(task, corridors, task.rows, paths[None], 0.0)[0]
    beyond = (paths < corridors.bounds[0, 0]) | (paths > corridors.bounds[1, 0])
    assert inside == (not beyond.any())
    assert np.all((corridors.free == corridors.bounds).any(axis=0)[0][beyond])
    gap = least_spare_gap(plane, angles, joint, paths)
    assert np.all(gap[~beyond] >= -1e-9)
    clipped = np.clip(paths, *corridors.bounds[:, 0])[None]
    assert keep_inside(task, corridors, task.rows, clipped, 0.0)[0]


@pytest.mark.parametrize("side", [1, -1])
def test_a_corridor_goes_around_an_obstacle(plane_at, side):
    # A stretched arm meets the disc halfway; folding takes the tip past the disc.
    limits = [[[-5.0, 5.0], [-np.pi, np.pi]]]
    plane = plane_at([[0.0, 0.0]], obstacles=[[6.0, 0.0, 0.8]], limits=limits)
    start = np.array([[-1.5, 0.0]])
    motion = SegmentMotion(start, [0, 1, 1], [1.5], [2.0])
    angles, low, high, is_open = bounds(plane, motion, 1, side)
    assert is_open
    middle = slice(SAMPLES // 2 - 1, SAMPLES // 2 + 2)
    assert np.all(side * (low + high)[middle] > 0.0)  # folded to that side at the disc
    assert low[0] <= 0.0 <= high[0] and low[-1] <= 0.0 <= high[-1]
    assert np.all(low[1:] <= high[:-1]) and np.all(high[1:] >= low[:-1])  # it can be passed
    assert not bounds(plane, motion, 1, 0)[3]


def test_a_robot_without_neighbours_has_the_full_reach(plane_at):
    plane = plane_at([[0.0, 0.0], [100.0, 0.0]])
    motion = SegmentMotion.at_rest([[0.0, 1.5], [0.0, 1.5]])
    _, low, high, is_open = bounds(plane, motion, 0, 0)
    assert is_open
    np.testing.assert_allclose(high, REACH_RAD)
    np.testing.assert_allclose(low, -REACH_RAD)
