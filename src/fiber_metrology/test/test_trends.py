# SPDX-License-Identifier: Apache-2.0
"""Trends over nights: what drifts is told, and what scatters is not."""

import numpy as np
import pytest

from fiber_core.presets import preset
from fiber_metrology import NUMBERS, MetrologyError, calibration_points, trend_of
from fiber_metrology.calibration import number_errors

N, NIGHTS = 400, 12


def fits(seed, scatter=1.0):
    rng = np.random.default_rng(seed)
    errors = rng.uniform(0.5, 2.0, (NIGHTS, N, len(NUMBERS)))
    numbers = 10.0 + scatter * errors * rng.normal(size=errors.shape)
    return np.arange(NIGHTS), numbers, errors


@pytest.mark.parametrize("scatter", [1.0, 10.0])
def test_numbers_that_scatter_do_not_drift(scatter):
    for seed in range(10):
        assert not trend_of(*fits(seed, scatter)).drifts.any()


def test_a_robot_that_scatters_more_than_its_errors_does_not_drift():
    for seed in range(10):
        nights, numbers, errors = fits(seed)
        numbers[:, 3] = 10.0 + 30.0 * (numbers[:, 3] - 10.0)
        assert not trend_of(nights, numbers, errors).drifts.any()


def test_a_number_that_drifts_is_told_with_its_slope():
    nights, numbers, errors = fits(1)
    numbers[:, 7, 3] += 3.0 * nights
    found = trend_of(nights, numbers, errors)
    assert np.argwhere(found.drifts).tolist() == [[7, 3]]
    assert abs(found.per_night[7, 3] - 3.0) < 4.0 * found.error[7, 3]
    slope = found.per_night / found.error
    assert 0.8 < np.std(np.delete(slope, 7, axis=0)) < 1.2


def test_robots_with_few_nights_have_no_trend_and_one_night_is_refused():
    nights, numbers, errors = fits(2)
    numbers[4:, 5] = np.nan
    numbers[:, 5, 0] += 100.0 * nights
    found = trend_of(nights, numbers, errors)
    assert not found.drifts[5].any() and np.isnan(found.per_night[5]).all()
    assert found.nights[5] == 4 and found.nights[6] == NIGHTS
    with pytest.raises(MetrologyError, match="two nights or more"):
        trend_of(np.zeros(3), numbers[:3], errors[:3])


def test_chosen_points_bring_the_zeros_below_half_of_what_random_ones_do():
    plane, rng = preset("desi", 7), np.random.default_rng(0)

    def zeros_deg(points):
        errors = number_errors(plane.arms[0], points, 2.5e-3, 0.005)[[4, 8]]
        return np.rad2deg(np.sqrt(np.mean(errors**2)))

    low, high = plane.limits[0].T
    drawn = [zeros_deg(low + (high - low) * rng.uniform(0.02, 0.98, (21, 2))) for _ in range(40)]
    chosen = calibration_points(plane, 20, rng)
    assert chosen.shape == (21, 7, 2)
    assert zeros_deg(chosen[:, 0]) < 0.5 * np.median(drawn)
    turned = np.rad2deg(np.abs(np.diff(chosen, axis=0)))
    assert turned.min() >= 2.0 - 1e-9
    assert (chosen >= plane.limits[:, :, 0]).all() and (chosen <= plane.limits[:, :, 1]).all()
    with pytest.raises(MetrologyError, match="7 points: a calibration needs 8 or more"):
        calibration_points(plane, 7, rng)
