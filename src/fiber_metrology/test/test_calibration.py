# SPDX-License-Identifier: Apache-2.0
"""Calibration: geometry and gears come back from a history, and bad gears are told."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.presets import preset
from fiber_metrology import GearVerdict, MetrologyError, calibrate
from fiber_metrology.calibration import _residuals

N, P = 30, 20


class History:
    """Robots that differ from their plane, and where their fibres were at some points."""

    def __init__(self, seed=1, noise_um=0.0, points=P):
        self.plane = preset("desi", N)
        rng = np.random.default_rng(seed)
        self.true = replace(
            self.plane,
            centers=self.plane.centers + rng.normal(0.0, 0.03, (N, 2)),
            arms=self.plane.arms + rng.normal(0.0, 0.03, (N, 2)),
        )
        self.zeros = rng.normal(0.0, 0.02, (N, 2))
        self.scale = 1.0 + rng.normal(0.0, 0.005, (N, 2, 2))
        self.backlash = rng.uniform(0.0, 0.005, (N, 2))
        low, high = np.moveaxis(self.plane.limits, -1, 0)
        self.counters = rng.uniform(low, high, (points + 1, N, 2))
        self.noise = rng.normal(0.0, 1e-3 * noise_um, (points, N, 2))

    def calibrate(self, slip=0.0, **settings):
        turned = np.diff(self.counters, axis=0)
        made = turned * np.where(turned > 0, self.scale[..., 1], self.scale[..., 0])
        made = made * (1.0 - slip * np.random.default_rng(5).random(made.shape))
        angles = self.counters[0] + self.zeros + np.cumsum(made, axis=0)
        angles -= np.sign(turned) * self.backlash / 2.0
        places = np.array([kinematics.forward(self.true, a)[1] for a in angles]) + self.noise
        return calibrate(self.plane, self.counters, places, **settings), places


def test_without_noise_every_number_comes_back():
    history = History()
    found, _ = history.calibrate(error_um=0.01)
    np.testing.assert_allclose(found.centers, history.true.centers, atol=1e-5)
    np.testing.assert_allclose(found.arms, history.true.arms, atol=1e-5)
    np.testing.assert_allclose(found.zeros, history.zeros, atol=1e-5)
    np.testing.assert_allclose(found.scale, history.scale, atol=1e-5)
    np.testing.assert_allclose(found.backlash_rad, history.backlash, atol=1e-5)
    assert (found.verdict == GearVerdict.GOOD).all() and found.rms_um.max() < 0.01


def test_the_errors_that_are_told_are_those_that_are_made():
    history = History(seed=2, noise_um=4.0)
    found, _ = history.calibrate(error_um=4.0)
    arms = (found.arms - history.true.arms) / found.errors[:, 2:4]
    scale = (found.scale - history.scale)[:, :, [1, 0]] / found.errors[:, [[5, 6], [9, 10]]]
    for off in (arms, scale):
        assert 0.7 < np.sqrt(np.mean(off**2)) < 1.4


def test_linear_stuck_and_slipping_gears_are_told_apart():
    history = History(seed=3, noise_um=3.0)
    history.scale[0, 1], history.scale[1, 0] = 0.7, 0.63
    history.scale[2, 0], history.scale[3, 1], history.scale[4] = 0.0, 0.0, 0.0
    slip = np.zeros((N, 2))
    slip[5, 0] = slip[6, 1] = 0.3
    found, _ = history.calibrate(slip)
    told = [GearVerdict.LINEAR] * 2 + [GearVerdict.STUCK] * 3 + [GearVerdict.SLIPPING] * 2
    assert found.verdict[:7].tolist() == told
    assert (found.verdict[7:] == GearVerdict.GOOD).all()
    np.testing.assert_allclose(found.scale[0, 1], 0.7, atol=0.01)
    applied = found.applied_to(history.plane)
    np.testing.assert_array_equal(applied.arms[2:7], history.plane.arms[2:7])
    np.testing.assert_allclose(applied.arms[7:], history.true.arms[7:], atol=0.02)


def test_missing_places_are_left_out_and_too_few_are_told():
    history = History(seed=4)
    history.noise[::3, 0], history.noise[3:, 1] = np.nan, np.nan
    found, _ = history.calibrate()
    assert found.points[:2].tolist() == [13, 3]
    assert found.verdict[0] == GearVerdict.GOOD and found.verdict[1] == GearVerdict.UNMEASURED
    np.testing.assert_allclose(found.arms[0], history.true.arms[0], atol=1e-3)
    np.testing.assert_array_equal(found.applied_to(history.plane).arms[1], history.plane.arms[1])


def test_the_jacobian_is_the_derivative_of_the_residuals():
    rng = np.random.default_rng(6)
    args = (
        rng.normal(size=2), np.array([3.0, 3.0]), rng.normal(size=2),
        rng.normal(size=(4, 2, 2)), np.sign(rng.normal(size=(4, 2))), rng.normal(size=(4, 2)), 1.0,
    )  # fmt: skip
    x, jacobian, out = rng.normal(size=12), np.empty((8, 12)), np.empty(8)
    _residuals(x, *args, jacobian, out)
    for k in range(12):
        step = np.zeros(12)
        step[k] = 1e-6
        ends = [np.empty(8), np.empty(8)]
        for sign, end in zip((1, -1), ends):
            _residuals(x + sign * step, *args, np.empty((8, 12)), end)
        np.testing.assert_allclose(jacobian[:, k], (ends[0] - ends[1]) / 2e-6, atol=1e-6)


def test_bad_histories_are_refused_with_the_robot():
    history = History()
    _, places = history.calibrate()
    with pytest.raises(MetrologyError, match="counters has shape"):
        calibrate(history.plane, history.counters[1:], places)
    broken = history.counters.copy()
    broken[3, 7, 0] = np.inf
    with pytest.raises(MetrologyError, match=f"robot {history.plane.ids[7]}: a counter"):
        calibrate(history.plane, broken, places)
    with pytest.raises(MetrologyError, match="error_um and slips_um"):
        calibrate(history.plane, history.counters, places, error_um=0.0)
