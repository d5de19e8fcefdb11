# SPDX-License-Identifier: Apache-2.0
"""Trend of the calibrated numbers of robots over nights: which of them drift."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2, norm
from scipy.stats import t as student

from fiber_core.array_types import Bools, Floats
from fiber_core.validation import frozen_array
from fiber_metrology.calibration import NUMBERS
from fiber_metrology.errors import MetrologyError

__all__ = ["Trend", "trend_of"]

_CHANCE = 1e-9  # of a number that does not drift, to be told so
_ODD = 1e-4  # chance of a scatter, below which the errors do not explain it
_LEAST = 5  # nights: the scatter about a line is not known from fewer


@dataclass(frozen=True, eq=False)
class Trend:
    """Change of the twelve numbers of each robot over nights.

    Args:
        per_night: slope of the straight line that fits best, in units of `NUMBERS`, shape (n, 12),
            nan for fewer than five nights.
        error: its standard error, by the errors of the numbers and by what the lines of all robots
            and of this one leave, whichever is larger, shape (n, 12).
        nights: number of nights with a fit, shape (n,).
        drifts: whether a slope is larger than chance makes one of 1e9, shape (n, 12).
    """

    per_night: Floats
    error: Floats
    nights: Floats
    drifts: Bools


def trend_of(nights: ArrayLike, numbers: ArrayLike, errors: ArrayLike) -> Trend:
    """Fit a straight line to each number of each robot over nights.

    Args:
        nights: the night of each calibration, shape (k,).
        numbers: fitted numbers of each night, nan where a robot has none, shape (k, n, 12).
        errors: their standard errors, shape (k, n, 12).

    Raises:
        MetrologyError: a shape does not fit, or all calibrations are of one night.
    """
    nights = frozen_array(nights, np.float64, (None,), "nights", MetrologyError)
    shape = (len(nights), None, len(NUMBERS))
    numbers = frozen_array(numbers, np.float64, shape, "numbers", MetrologyError)
    errors = frozen_array(errors, np.float64, numbers.shape, "errors", MetrologyError)
    if len(np.unique(nights)) < 2:
        raise MetrologyError("calibrations of two nights or more are needed for a trend")
    good = np.isfinite(numbers) & np.isfinite(errors) & (errors > 0.0)
    weight = np.where(good, 1.0 / np.where(good, errors, 1.0) ** 2, 0.0)
    value, when = np.where(good, numbers, 0.0), nights[:, None, None]
    total = np.maximum(weight.sum(axis=0), 1e-300)
    middle = (weight * when).sum(axis=0) / total
    mean = (weight * value).sum(axis=0) / total
    squares = (weight * (when - middle) ** 2).sum(axis=0)
    slope = (weight * (when - middle) * value).sum(axis=0) / np.maximum(squares, 1e-300)
    left = (weight * (value - mean - slope * (when - middle)) ** 2).sum(axis=0)
    count = good.sum(axis=0)
    enough = (count >= _LEAST) & (squares > 0.0)
    free = np.maximum(count - 2, 1)
    # numbers that scatter more than their errors, of all robots or of one, do not drift for that
    of_all = np.median(np.where(enough, left / free, 1.0), axis=0) if left.size else 1.0
    left = left / np.maximum(of_all, 1.0)
    odd = chi2.sf(left, free) < _ODD
    wider = np.maximum(of_all, 1.0) * np.where(odd, left / free, 1.0)
    slope = np.where(enough, slope, np.nan)
    error = np.where(enough, np.sqrt(wider / np.maximum(squares, 1e-300)), np.nan)
    most = np.where(odd, student.isf(_CHANCE / 2, free), norm.isf(_CHANCE / 2))
    return Trend(slope, error, count.max(axis=1), np.abs(slope) > most * error)
