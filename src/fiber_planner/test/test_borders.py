# SPDX-License-Identifier: Apache-2.0
"""Robots at the borders of sectors keep wider gaps, and the plane does not wait for them."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core.fields import random_problem
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_planner import make_planner


# in these fields the ends of one pair are nearer than stops so far apart allow
@pytest.mark.parametrize("seed", [4, 32])
def test_a_pair_that_is_stuck_at_a_border_costs_one_target_and_no_time_of_all(seed):
    plane, planner = preset("desi", 60), make_planner("direct", border_stop_skew_s=24.5e-3)
    plane = replace(plane, sector=np.arange(60) % 3)  # most pairs are of two sectors
    problem = random_problem(plane, np.random.default_rng(seed))
    one = replace(problem, plane=replace(plane, sector=np.zeros(60, dtype=np.int64)))
    planned, alone = planner.plan(problem), planner.plan(one)
    assert planned.motion.time_s[-1] <= 1.11 * alone.motion.time_s[-1]
    assert np.count_nonzero(planned.reason != Reason.OK) <= 1
    assert (alone.reason == Reason.OK).all()
