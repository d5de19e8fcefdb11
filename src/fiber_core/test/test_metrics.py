"""A report says what happened, and its lower bound is the time the slowest robot needs alone."""

import json

import numpy as np
import pytest

from fiber_core import Outcome, Problem, Reason, SegmentMotion, forward, preset
from fiber_core.clearance import Safety, certify
from fiber_core.metrics import lower_bound_s, plan_metrics
from fiber_core.problem_sources import problem_from


def _turned(robots, turn=0.4):
    """The first robot turns theta by some angle to its target; the others have none."""
    plane = preset("desi", robots=robots)
    start = np.tile([0.3, 2.0], (robots, 1))
    lasts = turn / plane.speeds[0, 0]
    offsets = np.concatenate([[0], np.ones(2 * robots)])
    motion = SegmentMotion(start, offsets, [lasts], [plane.speeds[0, 0]])
    targets = np.full((robots, 2), np.nan)
    targets[0] = forward(plane, motion.end)[1][0]
    return Problem(plane, start, targets), motion


def _report(problem, motion):
    outcome = np.where(problem.asked, Outcome.REACHED, Outcome.HELD)
    reason = np.where(problem.asked, Reason.OK, Reason.NO_TARGET)
    certificate = certify(problem.plane, motion, Safety())
    return plan_metrics(problem, motion, certificate, outcome, reason)


def test_a_robot_that_goes_straight_meets_the_bound():
    problem, motion = _turned(7)
    report = _report(problem, motion)
    assert (report["robots"], report["asked"], report["reached"], report["held"]) == (7, 1, 1, 0)
    assert report["reasons"] == {"ok": 1}
    assert report["makespan_ratio"] == pytest.approx(1.0, rel=1e-12)
    assert report["segments_mean"] == report["segments_max"] == 1
    assert report["end_error_um_max"] < 1e-9


def test_the_end_error_is_the_distance_from_tip_to_target():
    problem, motion = _turned(7)
    targets = problem.targets.copy()
    targets[0, 0] += 3e-3
    report = _report(Problem(problem.plane, problem.start, targets), motion)
    assert report["end_error_um_max"] == pytest.approx(3.0, abs=1e-9)


def test_disabled_robots_do_not_count_in_the_bound():
    problem, _ = _turned(7)
    assert lower_bound_s(problem) > 0
    enabled = np.arange(7) > 0
    off = Problem(problem.plane.with_enabled(enabled), problem.start, problem.targets)
    assert lower_bound_s(off) == 0


def test_a_robot_alone_has_nobody_near_and_the_report_is_still_json():
    report = _report(*_turned(1))
    assert report["min_clearance_mm"] is None and report["min_clearance_ids"] == []
    assert json.loads(json.dumps(report, allow_nan=False)) == report


def test_a_problem_comes_from_an_instrument_with_its_seed():
    first, again, other = (problem_from(robots=19, seed=seed) for seed in (4, 4, 5))
    assert first.plane.name == "desi" and first.plane.n == 19
    np.testing.assert_array_equal(first.targets, again.targets)
    assert not np.array_equal(first.start, other.start)
