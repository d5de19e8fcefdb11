"""Corridors of sent orders: robots never meet inside, and most walls are beside a neighbour."""

import itertools

import numpy as np
import pytest

from fiber_core.clearance import Safety, certified_pairs, gaps
from fiber_core.fields import random_field
from fiber_core.motion import SampledMotion
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_discretizer import discretize, joint_corridors

SAFETY = Safety()


@pytest.fixture(scope="module", params=["desi", "sdss_v"])
def case(request):
    """A random field, and straight lines to its targets as far as they are safe."""
    plane = preset(request.param, 61)
    problem = random_field(plane, np.random.default_rng(3)).problem
    units = WireUnits.for_plane(plane)
    start = units.encoder_counts(plane, problem.start)
    ends = random_field(plane, np.random.default_rng(4)).problem.start
    lasts = 1.05 * (np.abs(ends - problem.start) / plane.speeds).max()
    plan = SampledMotion([0.0, lasts], np.stack([units.to_angles(start), ends], axis=-1))
    motion = discretize(plane, plan, units, SAFETY, start).wire.decoded()
    assert (motion.counts > 0).any(axis=1).sum() > 25
    return plane, motion, joint_corridors(plane, motion, SAFETY)


def test_the_sent_motion_is_inside_its_corridors(case):
    _, motion, corridors = case
    np.testing.assert_array_equal(corridors.lasts_s, motion.durations.max(axis=1))
    for row in range(motion.n):
        for k, t in enumerate(corridors.times_s(row)):
            sent = motion(t)[row]
            assert (corridors.low[row, :, k] <= sent + 1e-9).all()
            assert (sent <= corridors.high[row, :, k] + 1e-9).all()


def test_inside_a_corridor_every_gap_is_at_least_the_required_gap(case):
    plane, motion, corridors = case
    pairs = certified_pairs(plane, motion, SAFETY)
    required = SAFETY.required_mm(plane, motion, pairs)
    rng = np.random.default_rng(5)
    for row in rng.choice(motion.n, 30, replace=False):
        own = (pairs == row).any(axis=1)
        joint, k = rng.integers(2), rng.integers(1, corridors.low.shape[2])
        angles = motion(corridors.times_s(row)[k])
        low, high = corridors.low[row, joint, k], corridors.high[row, joint, k]
        for share in np.linspace(0, 1, 9):
            angles[row, joint] = low + share * (high - low)
            assert (gaps(plane, pairs[own], angles) >= required[own] - 1e-4).all(), row


def test_most_walls_are_at_a_neighbour_at_a_limit_or_far_away(case):
    plane, motion, corridors = case
    pairs = certified_pairs(plane, motion, SAFETY)
    required = SAFETY.required_mm(plane, motion, pairs)
    met = []
    for row, k in itertools.product(range(motion.n), (0, 6, 12, 18, 24)):
        own = (pairs == row).any(axis=1)
        angles = motion(corridors.times_s(row)[k])
        for joint in (0, 1):
            sent, wall = angles[row, joint], corridors.high[row, joint, k]
            if wall - sent > 1.59 or wall > plane.limits[row, joint, 1] - 1e-6:
                continue
            beyond = angles.copy()
            beyond[row, joint] = wall + 0.02
            met.append((gaps(plane, pairs[own], beyond) < required[own]).any())
    # along a neighbour steps are short, and the search ends before the wall: the safe side
    assert len(met) > 20 and np.mean(met) > 0.6
