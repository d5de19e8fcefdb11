# SPDX-License-Identifier: Apache-2.0
"""Corridors of sent orders: no robots meet inside, and neighbours are at their bounds."""

import itertools
import threading
import time

import numpy as np
import pytest

from fiber_core.clearance import Safety, certified_pairs, gaps, levers_of
from fiber_core.fields import random_field
from fiber_core.motion import SampledMotion, SegmentMotion
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits
from fiber_discretizer import discretize, joint_corridors
from fiber_discretizer.corridor import FINEST_RAD

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


def test_every_bound_is_at_a_neighbour_at_a_limit_or_far_away(case):
    # so a joint that passes close to a neighbour at one instant has a corridor at all others
    plane, motion, corridors = case
    pairs = certified_pairs(plane, motion, SAFETY)
    required, levers = SAFETY.required_mm(plane, motion, pairs), levers_of(plane)
    bounds_met = 0
    for row, k in itertools.product(range(motion.n), (0, 6, 12, 18, 24)):
        own = (pairs == row).any(axis=1)
        angles = motion(corridors.times_s(row)[k])
        for joint, side in itertools.product((0, 1), (0, 1)):
            bound = (corridors.low, corridors.high)[side][row, joint, k]
            limit = plane.limits[row, joint, side]
            if abs(bound - angles[row, joint]) > 1.59 or abs(bound - limit) < 1e-9:
                continue
            turned = angles.copy()
            turned[row, joint] = bound
            spare = gaps(plane, pairs[own], turned) - required[own]
            assert spare.min() < FINEST_RAD * levers[row, joint] + 1e-5, (row, joint, k)
            bounds_met += 1
    assert bounds_met > 20


def all_turn(robots):
    """A plane, and a motion that turns all joints to other places, safe or not."""
    plane = preset("desi", robots)
    start, end = (random_field(plane, np.random.default_rng(k)).problem.start for k in (6, 7))
    offsets, seconds = np.arange(2 * robots + 1), np.full(2 * robots, 2.0)
    return plane, SegmentMotion(start, offsets, seconds, (end - start).ravel() / 2.0)


def test_other_threads_run_while_corridors_are_traced():
    # the discretizer computes them when the orders are out, and answers meanwhile
    joint_corridors(*all_turn(7), SAFETY)  # compiles
    work = threading.Thread(target=joint_corridors, args=(*all_turn(2000), SAFETY))
    work.start()
    begin_s = last_s = time.monotonic()
    longest_s = 0.0
    while work.is_alive():
        time.sleep(0.001)
        before_s, last_s = last_s, time.monotonic()
        longest_s = max(longest_s, last_s - before_s)
    assert longest_s < 0.25 * (last_s - begin_s)
