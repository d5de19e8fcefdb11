# SPDX-License-Identifier: Apache-2.0
"""Disabled robots nearer than the margin to what cannot move are no failure of a plan."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import Outcome, Problem, Reason, SegmentMotion, forward, preset
from fiber_core.clearance import Safety, certify, gaps, hold_until_safe
from fiber_core.metrics import plan_metrics

MARGIN_MM = 0.05


def beside_a_wall(gap_mm, enabled, moves=False):
    """Two robots far apart, the first that far from a wall; either it or the second turns."""
    plane = preset("desi", robots=2)
    plane = replace(
        plane,
        centers=np.array([[0.0, 0.0], [100.0, 0.0]]),
        enabled=np.array([enabled, True]),
    )
    start = np.array([[0.0, 0.5], [0.0, 0.5]])
    wall = np.array([[0.0, -5.0], [4.0, -5.0], [4.0, 5.0], [0.0, 5.0]])
    at_zero = replace(plane, walls=(wall + [20.0, 0.0])[None])
    clear = gaps(at_zero, [[0, 2]], start)[0]
    plane = replace(plane, walls=(wall + [20.0 - clear + gap_mm, 0.0])[None])
    turns = [0, 0, 1, 0] if not moves else [0, 1, 0, 0]
    motion = SegmentMotion(start, np.append(0, np.cumsum(turns)), [0.5], [0.1])
    return plane, motion


@pytest.mark.parametrize(
    ("gap_mm", "enabled", "close", "ok"),
    [
        (0.04, False, True, True),
        (0.04, True, False, False),  # it could be moved away
        (-0.01, False, False, False),  # it touches the wall
        (0.06, False, False, True),
    ],
)
def test_a_robot_at_rest_nearer_to_a_wall_than_the_margin(gap_mm, enabled, close, ok):
    plane, motion = beside_a_wall(gap_mm, enabled)
    certificate = certify(plane, motion, Safety(MARGIN_MM))
    assert certificate.close_at_rest_robots.tolist() == [close, False]
    assert certificate.ok is ok
    _, held, of_rest = hold_until_safe(plane, motion, Safety(MARGIN_MM))
    assert not held.any() and of_rest.ok is ok


def test_a_disabled_robot_that_moves_beside_a_wall_is_no_fact_of_the_plane():
    plane, motion = beside_a_wall(0.04, False, moves=True)
    certificate = certify(plane, motion, Safety(MARGIN_MM))
    assert not certificate.close_at_rest.any() and not certificate.ok


def test_the_report_names_the_pair():
    plane, motion = beside_a_wall(0.04, False)
    targets = np.full((2, 2), np.nan)
    targets[1] = forward(plane, motion.end)[1][1]
    problem = Problem(plane, motion.start, targets)
    outcome = np.array([Outcome.HELD, Outcome.REACHED])
    reason = np.array([Reason.NO_TARGET, Reason.OK])
    certificate = certify(plane, motion, Safety(MARGIN_MM))
    report = plan_metrics(problem, motion, certificate, outcome, reason, MARGIN_MM)
    assert report["certified"] and report["close_at_rest_ids"] == [[int(plane.ids[0]), "wall 0"]]
    (nearer,) = report["nearer_from_start"]
    assert nearer["ids"] == [int(plane.ids[0]), "wall 0"]
    assert nearer["gap_mm"] == pytest.approx(0.04, abs=1e-3)
