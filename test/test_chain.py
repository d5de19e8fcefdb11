"""From a plan to its orders, on cores alone: every robot with a certified plan gets orders."""

import numpy as np
import pytest

from fiber_core.clearance import Safety, certify
from fiber_core.fields import random_problem
from fiber_core.metrics import lower_bound_s
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_discretizer import discretize
from fiber_planner import make_planner


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
    problem = random_problem(preset(name, robots), np.random.default_rng(seed))
    plane, units, safety = problem.plane, WireUnits.for_plane(problem.plane), Safety()
    counts = units.encoder_counts(plane, problem.start)
    problem = Problem(plane, units.to_angles(counts), problem.targets)
    planned = make_planner("direct").plan(problem)
    assert (planned.reason == Reason.OK).all()
    sent = discretize(plane, planned.motion, units, safety, counts)
    assert (sent.reason == Reason.OK).all()
    motion = sent.wire.decoded()
    assert certify(plane, motion, safety).ok
    assert motion.makespan_s <= ratio * lower_bound_s(problem)
    segments = motion.counts[motion.counts > 0]
    assert segments.mean() <= mean and segments.max() <= 5
