# SPDX-License-Identifier: Apache-2.0
"""Calibration: from a history of ordered and measured places to the geometry and gears of robots.

The arm of a joint whose counter has turned by P >= 0 in all towards higher angles and by M <= 0
towards lower ones, and last in the direction d = +1 or -1, stands at

    angle = first counter + zero + up P + down M - backlash d / 2,

and the tip at centre + l1 u(theta) + l2 u(theta + phi), with u the unit vector. The twelve numbers
of a robot are fitted to its measured places by Levenberg and Marquardt's method, with a weak normal
prior about the plane as it is; all robots in one compiled loop.
"""

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numba as nb
import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Angles, Codes, Floats, Ints, Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.validation import frozen_array
from fiber_metrology.errors import MetrologyError

__all__ = ["NUMBERS", "Calibration", "GearVerdict", "calibrate", "number_errors"]

_NUMBERS = 12  # centre x, y, l1, l2, then zero, up, down, backlash of theta and of phi
# their names, with units; scales towards higher angles are rising
NUMBERS = ("x_mm", "y_mm", "arm_theta_mm", "arm_phi_mm") + tuple(
    f"{joint}_{what}"
    for joint in ("theta", "phi")
    for what in ("zero_rad", "scale_rising", "scale_falling", "backlash_rad")
)
_PRIOR = np.array([0.3, 0.3, 0.1, 0.1] + 2 * [0.2, 0.5, 0.5, 0.01])  # [mm], [rad], 1
_LEAST_POINTS = 8  # 16 coordinates for 12 numbers
_ROUNDS = 60
# Scales from which the fit begins; the later ones serve where the first leaves large residuals, or
# numbers that are unlikely: an arm of no length explains a stuck joint as well as a scale of 0.
_LIKELY = 30.0  # sum of squares of the numbers about the prior, in its widths
_SCALES = np.array([[1.0, 1.0], [1.0, 0.75], [0.75, 1.0], [1.0, 0.0], [0.0, 1.0], [0.0, 0.0],
                    [0.75, 0.75]])  # fmt: skip
_LINEAR, _STUCK = 0.05, 0.1  # a scale so far from 1; a scale so close to 0


class GearVerdict(IntEnum):
    """What the history of a robot says about its gears."""

    GOOD = 0
    LINEAR = 1  # a scale is another one than 1, and the robot keeps to it
    STUCK = 2  # a joint does not turn
    SLIPPING = 3  # no scale explains the places
    UNMEASURED = 4  # too few places


@dataclass(frozen=True, eq=False)
class Calibration:
    """Geometry and gears of n robots.

    Args:
        centers: theta axes [mm], shape (n, 2).
        arms: lengths of both arms [mm], shape (n, 2).
        zeros: angle of the arm less that of its counter at the first point [rad], shape (n, 2).
        scale: angle of the arm over angle of the counter, towards lower and towards higher angles,
            shape (n, 2, 2).
        backlash_rad: lost motion at a reversal [rad], shape (n, 2).
        errors: standard errors of the twelve numbers, in the order centre, arms, then zero, scale
            up, scale down and backlash of theta and of phi, shape (n, 12).
        rms_um: rms distance of the places from the model [um], shape (n,).
        points: number of places of each robot, shape (n,).
        verdict: GearVerdict of each robot, shape (n,).
    """

    centers: Points
    arms: Floats
    zeros: Angles
    scale: Floats
    backlash_rad: Angles
    errors: Floats
    rms_um: Floats
    points: Ints
    verdict: Codes

    @property
    def numbers(self) -> Floats:
        """The twelve numbers in the order of `errors` and of `NUMBERS`, shape (n, 12)."""
        rising, falling = self.scale[:, :, 1], self.scale[:, :, 0]
        gears = np.stack([self.zeros, rising, falling, self.backlash_rad], axis=2)
        return np.concatenate([self.centers, self.arms, gears.reshape(len(gears), 8)], axis=1)

    def applied_to(self, plane: FocalPlane) -> FocalPlane:
        """Return the plane with the centres, arms and zeros of robots that keep to a model.

        Zeros turn the ranges: where a counter read c the arm stood at c + zero, so its stops are
        there too. A range of phi that began at 0 or above still does, and one that ended at pi or
        below still does: a robot does not get a second elbow by a zero.

        Args:
            plane: the plane that was calibrated.
        """
        good = np.isin(self.verdict, (GearVerdict.GOOD, GearVerdict.LINEAR))[:, None]
        limits = plane.limits + self.zeros[:, :, None]
        low, high = plane.limits[:, 1].T
        limits[:, 1, 0] = np.maximum(limits[:, 1, 0], np.where(low >= 0.0, 0.0, -np.inf))
        limits[:, 1, 1] = np.minimum(limits[:, 1, 1], np.where(high <= np.pi, np.pi, np.inf))
        return replace(
            plane,
            centers=np.where(good, self.centers, plane.centers),
            arms=np.where(good, self.arms, plane.arms),
            limits=np.where(good[:, :, None], limits, plane.limits),
        )


def calibrate(
    plane: FocalPlane,
    counters: ArrayLike,
    places: ArrayLike,
    error_um: float = 4.0,
    slips_um: float = 100.0,
) -> Calibration:
    """Fit geometry and gears of every robot to its history.

    Between two points the joints turn one way. A joint must turn further than its backlash.

    Args:
        plane: the plane as it is known.
        counters: joint angles by the counters, at the start and at every point [rad], shape
            (p + 1, n, 2).
        places: measured places at the points [mm], shape (p, n, 2), nan for none.
        error_um: error of one coordinate of a place, 1 sigma [um].
        slips_um: rms distance from the model above which a robot slips [um].

    Raises:
        MetrologyError: a shape does not fit, a counter is not finite, or an error is not positive.
    """
    n = plane.n
    places = frozen_array(places, np.float64, (None, n, 2), "places", MetrologyError)
    shape = (len(places) + 1, n, 2)
    counters = frozen_array(counters, np.float64, shape, "counters", MetrologyError)
    bad = ~np.isfinite(counters).all(axis=(0, 2))
    if bad.any():
        raise MetrologyError(f"robot {plane.ids[np.argmax(bad)]}: a counter is not finite")
    if not (error_um > 0.0 and slips_um > 0.0):
        raise MetrologyError(f"error_um and slips_um must be positive: {error_um}, {slips_um}")
    turned = np.diff(counters, axis=0)
    travel = np.stack(
        [np.cumsum(np.maximum(turned, 0.0), 0), np.cumsum(np.minimum(turned, 0.0), 0)], axis=-1
    )
    numbers, errors = np.empty((n, _NUMBERS)), np.empty((n, _NUMBERS))
    rms_mm, points = np.empty(n), np.empty(n, dtype=np.int64)
    # robot first, as each is fitted by itself
    _fit_all(
        plane.centers, plane.arms, np.ascontiguousarray(counters[0]),
        np.ascontiguousarray(travel.transpose(1, 0, 2, 3)),
        np.ascontiguousarray(_directions(turned).transpose(1, 0, 2)),
        np.ascontiguousarray(places.transpose(1, 0, 2)), error_um * 1e-3, slips_um * 1e-3,
        numbers, errors, rms_mm, points,
    )  # fmt: skip
    joints = numbers[:, 4:].reshape(n, 2, 4)
    scale = joints[:, :, [2, 1]]
    verdict = np.where((np.abs(scale - 1.0) > _LINEAR).any(axis=(1, 2)), GearVerdict.LINEAR, 0)
    verdict = np.where(np.any(np.all(scale < _STUCK, axis=2), axis=1), GearVerdict.STUCK, verdict)
    verdict = np.where(rms_mm > slips_um * 1e-3, GearVerdict.SLIPPING, verdict)
    verdict = np.where(points < _LEAST_POINTS, GearVerdict.UNMEASURED, verdict)
    return Calibration(
        plane.centers + numbers[:, :2], plane.arms + numbers[:, 2:4], joints[:, :, 0], scale,
        joints[:, :, 3], errors, rms_mm * 1e3, points, verdict,
    )  # fmt: skip


def number_errors(arms: Floats, counters: Angles, error_mm: float, backlash_rad: float) -> Floats:
    """Return the errors that the numbers of a sound robot have after a calibration, shape (12,).

    Args:
        arms: lengths of both arms [mm], shape (2,).
        counters: joint angles at the start and at every point [rad], shape (p + 1, 2).
        error_mm: error of one coordinate of a place [mm].
        backlash_rad: lost motion of both joints [rad].
    """
    turned = np.diff(counters, axis=0)
    travel = np.stack(
        [np.cumsum(np.maximum(turned, 0.0), 0), np.cumsum(np.minimum(turned, 0.0), 0)], axis=-1
    )
    way, p = _directions(turned[:, None])[:, 0], len(turned)
    x = np.zeros(_NUMBERS)
    x[5:7] = x[9:11] = 1.0
    x[7] = x[11] = backlash_rad
    jacobian = np.empty((2 * p, _NUMBERS))
    nowhere, zero = np.zeros((p, 2)), np.zeros(2)
    _residuals(
        x, zero, arms, counters[0], travel, way, nowhere, error_mm, jacobian, np.empty(2 * p)
    )
    normal = jacobian.T @ jacobian + np.diag(1.0 / _PRIOR**2)
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(normal))))


def _directions(turned: Floats) -> Floats:
    """The way each joint turned last, +1 or -1, 0 before its first turn, shape (p, n, 2)."""
    way = np.sign(turned)
    for k in range(1, len(way)):
        way[k] = np.where(way[k] == 0.0, way[k - 1], way[k])
    return way


@nb.njit(cache=True)
def _residuals(x, centre, arms, first, travel, way, places, error, jacobian, out):
    """Fill residuals and Jacobian in errors and prior widths; return the sum of squares."""
    p = len(places)
    total = 0.0
    for k in range(p):
        angle = np.empty(2)
        for j in range(2):
            at = 4 + 4 * j
            angle[j] = (
                first[j] + x[at] + x[at + 1] * travel[k, j, 0] + x[at + 2] * travel[k, j, 1]
                - x[at + 3] * way[k, j] / 2.0
            )  # fmt: skip
        l1, l2 = arms[0] + x[2], arms[1] + x[3]
        c1, s1 = math.cos(angle[0]), math.sin(angle[0])
        c2, s2 = math.cos(angle[0] + angle[1]), math.sin(angle[0] + angle[1])
        for axis in range(2):
            row = 2 * k + axis
            jacobian[row, :] = 0.0
            out[row] = 0.0
            if not math.isfinite(places[k, axis]):
                continue
            u1, u2 = (c1, c2) if axis == 0 else (s1, s2)
            v1, v2 = (-s1, -s2) if axis == 0 else (c1, c2)
            tip = centre[axis] + x[axis] + l1 * u1 + l2 * u2
            out[row] = (tip - places[k, axis]) / error
            total += out[row] ** 2
            jacobian[row, axis] = 1.0 / error
            jacobian[row, 2], jacobian[row, 3] = u1 / error, u2 / error
            for j in range(2):
                slope = (l1 * v1 + l2 * v2 if j == 0 else l2 * v2) / error
                at = 4 + 4 * j
                jacobian[row, at] = slope
                jacobian[row, at + 1] = slope * travel[k, j, 0]
                jacobian[row, at + 2] = slope * travel[k, j, 1]
                jacobian[row, at + 3] = -slope * way[k, j] / 2.0
    return total


@nb.njit(cache=True)
def _cholesky(matrix, lower):
    """Fill the lower factor of a positive matrix; return whether it is positive."""
    n = len(matrix)
    for i in range(n):
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= lower[i, k] * lower[j, k]
            if i == j:
                if rest <= 0.0:
                    return False
                lower[i, i] = math.sqrt(rest)
            else:
                lower[i, j] = rest / lower[j, j]
    return True


@nb.njit(cache=True)
def _solved(lower, right):
    """The solution of lower lower^T x = right."""
    n, x = len(right), right.copy()
    for i in range(n):
        for k in range(i):
            x[i] -= lower[i, k] * x[k]
        x[i] /= lower[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= lower[k, i] * x[k]
        x[i] /= lower[i, i]
    return x


@nb.njit(cache=True)
def _fit(x, centre, arms, first, travel, way, places, error, errors):
    """Improve the numbers x of one robot; return the sums of squares of all and of the places."""
    m, n = 2 * len(places), len(x)
    jacobian, res = np.empty((m, n)), np.empty(m)
    trial_jacobian, trial_res = np.empty((m, n)), np.empty(m)
    prior = np.zeros(n)
    prior[5], prior[6], prior[9], prior[10] = 1.0, 1.0, 1.0, 1.0  # scales
    lower = np.zeros((n, n))
    damp = 1e-3
    of_places = _residuals(x, centre, arms, first, travel, way, places, error, jacobian, res)
    cost = of_places + (((x - prior) / _PRIOR) ** 2).sum()
    normal = np.empty((n, n))
    for _ in range(_ROUNDS):
        right = -(x - prior) / _PRIOR**2
        for a in range(n):
            for b in range(a + 1):
                normal[a, b] = (jacobian[:, a] * jacobian[:, b]).sum()
            normal[a, a] += 1.0 / _PRIOR[a] ** 2
            right[a] -= (jacobian[:, a] * res).sum()
        improved, trial, new, found = False, x, cost, of_places
        for _ in range(12):
            damped = normal.copy()
            for a in range(n):
                damped[a, a] *= 1.0 + damp
            if _cholesky(damped, lower):
                step = _solved(lower, right)
                trial = x + step
                found = _residuals(
                    trial, centre, arms, first, travel, way, places, error,
                    trial_jacobian, trial_res,
                )  # fmt: skip
                new = found + (((trial - prior) / _PRIOR) ** 2).sum()
                if new < cost:
                    improved = True
                    break
            damp *= 5.0
        if not improved:
            break
        gain = cost - new
        x[:], cost, of_places = trial, new, found
        jacobian[:], res[:] = trial_jacobian, trial_res
        damp = max(damp / 10.0, 1e-12)
        if gain < 1e-6 * (1.0 + cost):
            break
    for a in range(n):
        for b in range(a + 1):
            normal[a, b] = (jacobian[:, a] * jacobian[:, b]).sum()
        normal[a, a] += 1.0 / _PRIOR[a] ** 2
    errors[:] = np.inf
    if _cholesky(normal, lower):
        unit = np.zeros(n)
        for a in range(n):
            unit[:] = 0.0
            unit[a] = 1.0
            errors[a] = math.sqrt(_solved(lower, unit)[a])
    return cost, of_places


@nb.njit(cache=True)
def _fit_all(centres, arms, first, travel, way, places, error, slips, numbers, errors, rms, points):
    for i in range(len(centres)):
        seen = 0
        for k in range(places.shape[1]):
            seen += 1 if math.isfinite(places[i, k, 0] + places[i, k, 1]) else 0
        points[i] = seen
        best = np.inf
        trial_errors = np.empty(_NUMBERS)
        for begin in range(len(_SCALES)):
            x = np.zeros(_NUMBERS)
            x[5:7], x[9:11] = _SCALES[begin, 0], _SCALES[begin, 1]
            cost, of_places = _fit(
                x, centres[i], arms[i], first[i], travel[i], way[i], places[i], error, trial_errors
            )
            if cost < best:
                best = cost
                numbers[i], errors[i] = x, trial_errors
                rms[i] = math.sqrt(of_places / max(seen, 1)) * error
            if rms[i] <= slips and cost - of_places <= _LIKELY:
                break
