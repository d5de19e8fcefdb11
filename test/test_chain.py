# SPDX-License-Identifier: Apache-2.0
"""From a plan to its orders, on cores alone: every robot with a certified plan gets orders."""

import pytest

from fiber_core.clearance import certify
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_positioners import make_orders, random_problem


@pytest.mark.parametrize(
    "name, robots, seed, ratio, mean",
    [
        ("desi", 200, 1, 1.1, 1.2),
        ("desi_outlines", 90, 2, 1.15, 1.4),
        ("pfs", 150, 3, 1.1, 1.25),
        ("sdss_v", 61, 4, 1.85, 2.2),
        ("moons", 60, 5, 1.85, 2.2),
    ],
)
def test_all_planned_robots_get_few_segments_and_a_certified_motion(
    name, robots, seed, ratio, mean
):
    orders = make_orders(random_problem(preset(name, robots), seed), planner="direct")
    assert (orders.planned.reason == Reason.OK).all()
    assert (orders.discretization.reason == Reason.OK).all()
    motion = orders.wire.decoded()
    assert certify(orders.plane, motion, orders.safety).ok
    assert motion.makespan_s <= ratio * lower_bound_s(orders.start_problem)
    segments = motion.counts[motion.counts > 0]
    assert segments.mean() <= mean and segments.max() <= 5
