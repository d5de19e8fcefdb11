# SPDX-License-Identifier: Apache-2.0
"""Metrics are the figures of a plan; the lower bound is the time of the slowest robot alone."""

import json

import numpy as np
import pytest

from fiber_core import Outcome, Problem, Reason, SegmentMotion, forward, preset
from fiber_core.clearance import Safety, certify
from fiber_core.metrics import lower_bound_s, plan_metrics


def _turned(robots, turn=0.4):
    """Return a plan: the first robot turns theta to its target; the others have no target."""
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
    return plan_metrics(problem, motion, certificate, outcome, reason, Safety().margin_mm)


def test_a_direct_motion_meets_the_lower_bound():
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


def test_pairs_too_close_from_the_start_are_named_and_are_not_the_least_clearance():
    problem, motion = _turned(7)
    alone = _report(problem, motion)
    assert alone["nearer_from_start"] == []
    # the last two robots rest, with arms that overlap
    start = motion.start.copy()
    towards = problem.plane.centers[6] - problem.plane.centers[5]
    theta = np.arctan2(*towards[::-1])
    start[5], start[6] = (theta, 0.0), (theta + np.pi, 0.0)
    overlapping = SegmentMotion(start, motion.offsets, motion.duration_s, motion.velocity_rad_s)
    report = _report(Problem(problem.plane, start, problem.targets), overlapping)
    ids = problem.plane.ids[[5, 6]].tolist()
    named = {tuple(each["ids"]): each["gap_mm"] for each in report["nearer_from_start"]}
    assert named[tuple(ids)] < 0.0 and all(gap < Safety().margin_mm for gap in named.values())
    assert report["min_clearance_mm"] >= Safety().margin_mm
    assert tuple(report["min_clearance_ids"]) not in named
    # the bound is as tight as that of a plane without such pairs
    pair = problem.plane.index_of(report["min_clearance_ids"])
    exact = certify(problem.plane, overlapping, Safety(), [np.sort(pair)])
    assert report["min_clearance_mm"] == pytest.approx(exact.min_gap_mm, abs=2e-3)


def test_metrics_of_a_single_robot_are_json():
    report = _report(*_turned(1))
    assert report["min_clearance_mm"] is None and report["min_clearance_ids"] == []
    assert json.loads(json.dumps(report, allow_nan=False)) == report
