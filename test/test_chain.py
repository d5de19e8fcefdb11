# SPDX-License-Identifier: Apache-2.0
"""From a plan to its orders, on cores alone: every robot with a certified plan gets orders."""

import numpy as np
import pytest

from fiber_core.clearance import certify
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.threads import threads
from fiber_planner import pair_bound
from fiber_planner.direct.blocks import blocks_of
from fiber_planner.direct.scene import scene_of
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


@pytest.mark.parametrize("name, robots, most", [("desi_outlines", 900, 1.12), ("pfs", 900, 1.07)])
def test_orders_have_hardly_more_segments_than_the_plan_has_lines(name, robots, most):
    orders = make_orders(random_problem(preset(name, robots), 1), planner="direct")
    lines = _lines(orders.planned.motion.angles)
    segments = orders.wire.decoded().counts
    assert segments.sum() <= 1.005 * lines.sum()
    assert segments[segments > 0].mean() <= most


@pytest.mark.parametrize("seed", [0, 1])
def test_a_few_robots_beside_disabled_arms_do_not_make_the_motion_of_all_longer(seed):
    rng, plane = np.random.default_rng(seed), preset("desi", 700)
    plane = plane.with_enabled(rng.random(plane.n) >= 0.15)
    orders = make_orders(random_problem(plane, rng), planner="direct")
    motion, start_problem = orders.wire.decoded(), orders.start_problem
    assert orders.discretization.certificate.ok
    assert motion.makespan_s <= 1.04 * lower_bound_s(start_problem)
    reached = np.count_nonzero((orders.reason == Reason.OK) & start_problem.asked)
    assert reached >= 0.99 * pair_bound(start_problem).robots


def _lines(angles):
    # straight pieces of each profile until its arrival, (n, 2)
    breaks = np.abs(np.diff(angles, 2, axis=2)) > 1e-9
    still = angles == angles[:, :, -1:]
    last = np.where(still.all(axis=2), 0, still.shape[2] - np.argmin(still[:, :, ::-1], axis=2))
    before = np.arange(1, angles.shape[2] - 1) < np.minimum(last, still.shape[2] - 1)[:, :, None]
    return (breaks & before).sum(axis=2) + (last > 0)


@pytest.mark.parametrize("name, robots", [("desi", 2500), ("desi_outlines", 2500), ("sdss_v", 61)])
def test_plans_and_orders_are_the_same_bytes_on_any_number_of_threads(name, robots):
    problem, wires = random_problem(preset(name, robots), 6), []
    for count in (1, 2, 3):
        with threads(count):
            wires.append(make_orders(problem, planner="direct").wire)
    for wire in wires[1:]:
        for column in ("start", "offsets", "ticks", "velocity"):
            assert getattr(wire, column).tobytes() == getattr(wires[0], column).tobytes()


def test_robots_inside_a_block_have_neighbours_there_only():
    plane = preset("desi", 5000)
    plane = plane.permuted(np.lexsort([plane.centers[:, 1], plane.centers[:, 0]]))
    scene = scene_of(random_problem(plane, 0))
    blocks = blocks_of(plane.n, scene.near)
    assert len(blocks.inside) > 2 and len(blocks.border) < 0.15 * plane.n
    block = np.full(plane.n, -1)
    for number, rows in enumerate(blocks.inside):
        block[rows] = number
    a, b = block[scene.pairs].T
    assert ((a == b) | (a < 0) | (b < 0)).all()
    both = [np.concatenate(wave) for wave in blocks.waves(backwards=True)]
    assert sorted(np.concatenate(both)) == list(range(plane.n))
