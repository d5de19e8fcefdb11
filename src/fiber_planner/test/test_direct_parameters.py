# SPDX-License-Identifier: Apache-2.0
"""Parameters of the direct planner: their ranges, and what makes a plan repeatable."""

import numpy as np
import pytest

from fiber_core.fields import random_problem
from fiber_core.presets import preset
from fiber_planner import PlannerError, make_planner
from fiber_planner.direct import DirectParameters, DirectPlanner


@pytest.mark.parametrize(
    "wrong",
    [{"margin_mm": -0.1}, {"intervals": 3}, {"intervals": 10.5}, {"stretch": 0.5},
     {"effort": float("nan")}, {"seed": -1}, {"budget_s": -1.0}, {"budget_s": float("nan")}],
)  # fmt: skip
def test_parameters_out_of_range_are_refused(wrong):
    with pytest.raises(PlannerError, match=next(iter(wrong))):
        make_planner("direct", **wrong)


def test_same_seed_same_bytes_and_another_seed_another_plan():
    problem = random_problem(preset("pfs", 150), np.random.default_rng(16))
    plans = [DirectPlanner(DirectParameters(seed=seed)).plan(problem) for seed in (0, 0, 1)]
    angles = [plan.motion.angles.tobytes() for plan in plans]
    assert angles[0] == angles[1] != angles[2]


def test_an_ample_budget_changes_nothing():
    problem = random_problem(preset("pfs", 100), np.random.default_rng(22))
    plans = [
        DirectPlanner(DirectParameters(budget_s=budget_s)).plan(problem).motion.angles.tobytes()
        for budget_s in (float("inf"), 1e6)
    ]
    assert plans[0] == plans[1]
