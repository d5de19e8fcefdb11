# SPDX-License-Identifier: Apache-2.0
"""Robots at the borders of sectors keep wider gaps, and the plane does not wait for them."""

from dataclasses import replace

import numpy as np

from fiber_core.clearance import neighbour_pairs
from fiber_core.fields import random_problem
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_planner import make_planner

FIELDS = 45


def test_pairs_that_are_stuck_at_borders_cost_few_targets_and_no_time_of_all():
    plane, planner = preset("desi", 60), make_planner("direct")
    plane = replace(plane, sector=np.arange(60) % 3)  # most pairs are of two sectors
    pairs = neighbour_pairs(plane)
    at_border = np.unique(pairs[plane.sector[pairs[:, 0]] != plane.sector[pairs[:, 1]]])
    lost = 0
    for seed in range(FIELDS):
        problem = random_problem(plane, np.random.default_rng(seed))
        one = replace(problem, plane=replace(plane, sector=np.zeros(60, dtype=np.int64)))
        planned, alone = planner.plan(problem), planner.plan(one)
        assert planned.motion.time_s[-1] <= 1.11 * alone.motion.time_s[-1], seed
        assert (alone.reason == Reason.OK).all(), seed
        rows = np.flatnonzero(planned.reason != Reason.OK)
        assert np.isin(rows, at_border).all(), seed
        lost += len(rows)
    # in some fields the ends of a pair are nearer than stops so far apart allow
    assert 0 < lost <= 0.01 * plane.n * FIELDS
