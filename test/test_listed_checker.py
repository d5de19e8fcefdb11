# SPDX-License-Identifier: Apache-2.0
"""The independent judge of listed speeds finds each mistake that is planted."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "bench"))
from listed_checker import check_listed  # noqa: E402

# one robot; theta: run, rest for the ramp, back, forth (falling); phi rests
_GOOD = [(0.4, 3.0), (0.03, 0.0), (1.0, 0.05), (1.0, -0.05)]
_NUMBERS = [2, 3.0, 0.05, 0.03, 0.0, 0.1, 0.0, 1e-6, 0.05, 0.05, -1.0, 1.0, 1, 1]


def judged(folder, theta, phi=(), limits=(-4.0, 4.0)):
    both = [*theta, *phi]
    duration, velocity = np.array(both).T
    np.savez(
        folder / "problem.npz",
        listed_speeds=np.array(_NUMBERS, dtype=float),
        motor_scale=np.ones((1, 2, 2)),
        bus=np.zeros(1, dtype=int),
        limits_rad=np.array([[limits, limits]]),
        arm_mm=np.full((1, 2), 3.0),
        radius_mm=np.ones(1),
        center_mm=np.zeros((1, 2)),
        target_mm=np.array([[np.cos(1.2), np.sin(1.2)]]) * 6.0,
    )
    np.savez(
        folder / "plan.npz",
        offsets=np.array([0, len(theta), len(both)]),
        duration_s=duration,
        velocity_rad_s=velocity,
        start_rad=np.zeros((1, 2)),
        outcome=np.zeros(1, dtype=int),
        outcome_names=np.array(["reached"]),
    )
    return check_listed(folder / "problem.npz", folder / "plan.npz")


def test_a_good_order_breaks_nothing(tmp_path):
    verdict = judged(tmp_path, _GOOD)
    assert verdict.violations == 0 and verdict.peak == 0.5
    assert verdict.makespan_s == pytest.approx(2.43)
    assert verdict.end_error_um < 1e-6


def test_motors_that_overlap_are_counted(tmp_path):
    back = [(0.5, 0.0), (1.0, -0.05), (1.0, 0.05)]
    assert judged(tmp_path, _GOOD, back).peak == 1.0


@pytest.mark.parametrize(
    ("name", "theta"),
    [
        ("speeds", [(0.4, 2.9), *_GOOD[1:]]),
        ("short", [(0.03, 3.0), *_GOOD[1:]]),
        ("approaches", _GOOD[:3]),
        ("approaches", [*_GOOD[:3], (0.9, -0.05)]),
        ("approaches", [*_GOOD[:2], (0.9, 0.05), _GOOD[3]]),
        ("ramps", [_GOOD[0], (0.02, 0.0), *_GOOD[2:]]),
        ("beyond", [(1.5, 3.0), *_GOOD[1:]]),
    ],
)
def test_each_broken_rule_is_found(tmp_path, name, theta):
    verdict = judged(tmp_path, theta)
    assert getattr(verdict, name) == 1 and verdict.violations == 1
