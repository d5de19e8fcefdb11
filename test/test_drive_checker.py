# SPDX-License-Identifier: Apache-2.0
"""The independent judge of plans with ramps: it passes our plans and detects planted mistakes."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from fiber_core.drive.named import with_drive
from fiber_core.presets import preset
from fiber_positioners import random_problem, reconfigure


@pytest.fixture(scope="module")
def judge():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[1] / "bench")
        return importlib.import_module("drive_checker")


@pytest.fixture(scope="module")
def saved(tmp_path_factory) -> tuple[Path, Path]:
    """The files of a plan of a small plane with a ramp."""
    plane = with_drive(preset("desi", 37), "accelerated")
    result = reconfigure(random_problem(plane, seed=2))
    assert result.report["reached"] == 37 and result.report["drive"] == "accelerated"
    folder = result.save(tmp_path_factory.mktemp("plan"), recording=False)
    return folder / "problem.npz", folder / "plan.npz"


def _changed(tmp_path, file: Path, **columns) -> Path:
    with np.load(file) as data:
        values = dict(data)
    for name, change in columns.items():
        values[name] = change(values[name].copy())
    np.savez(tmp_path / file.name, **values)
    return tmp_path / file.name


def test_our_plan_breaks_no_rule_and_has_our_curves(judge, saved):
    verdict = judge.check(*saved, errors=3)
    assert (verdict.violations, verdict.contacts, verdict.true_contacts) == (0, 0, 0)
    assert verdict.curve_error_rad < 1e-9 and verdict.least_gap_mm >= 0.05
    assert verdict.end_error_um < 2.0


def test_a_motion_that_is_too_fast_or_too_hard_is_detected(judge, saved, tmp_path):
    problem, plan = saved
    slow = _changed(tmp_path, problem, speed_rad_s=lambda speed: 0.9 * speed)
    assert judge.check(slow, plan).violations > 0
    soft = _changed(tmp_path, problem, acceleration_rad_s2=lambda limit: 0.9 * limit)
    assert judge.check(soft, plan).violations > 0
    short = _changed(tmp_path, problem, ramp_s=lambda ramp: 0.9 * ramp)
    verdict = judge.check(short, plan)
    assert verdict.violations > 0 and verdict.curve_error_rad > 1e-3


def test_contacts_are_detected_also_those_of_true_arms_alone(judge, saved, tmp_path):
    problem, plan = saved
    thick = _changed(tmp_path, problem, radius_mm=lambda radius: radius + 0.5)
    assert judge.check(thick, plan).contacts > 0
    unsure = _changed(tmp_path, problem, uncertainty_rad=lambda angle: angle + 0.1)
    verdict = judge.check(unsure, plan, errors=30)
    assert verdict.contacts == 0 and verdict.true_contacts > 0
