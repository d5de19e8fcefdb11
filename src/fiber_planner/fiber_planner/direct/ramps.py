# SPDX-License-Identifier: Apache-2.0
"""Motors with a ramp in the local search: whether they can change their speed as a profile asks."""

import math

import numba as nb

from fiber_core.array_types import Floats

__all__ = ["ramps_follow"]

_ROUNDING = 1.0 + 1e-9
_TWO_STEPS = 2.0  # the discretizer makes a change of up to twice the largest one in two steps
_SAME = 0.05  # share of the largest change by which speeds on one line differ at most


@nb.njit(cache=True)
def ramps_follow(row: Floats, step_s: float, ramp_s: float, largest_rad_s: float) -> bool:
    """Return whether a motor with a ramp can carry out a profile of one joint.

    The velocity of the joint is the mean of the ordered velocity over one ramp. Its acceleration is
    the difference of the velocities ordered now and a ramp ago, by the ramp: two intervals a ramp
    apart may differ by the largest change. A larger one is made in two steps with the mean velocity
    between them, where the lines on both sides last a ramp.

    Args:
        row: joint angles on the grid [rad], shape (k + 1,); the joint rests before and after.
        step_s: length of a grid interval [s].
        ramp_s: time over which the motor spreads each change of velocity [s].
        largest_rad_s: largest change of velocity within a ramp [rad/s].
    """
    last = len(row) - 1
    near = int(math.ceil(ramp_s / step_s - 1e-9))
    nearest = int(math.floor(ramp_s / step_s + 1e-9))
    most = largest_rad_s * step_s * _ROUNDING
    for k in range(last + near):
        turned = _turned(row, k)
        for j in range(k - near, k - nearest + 1):
            change = abs(turned - _turned(row, j))
            if change <= most:
                continue
            if change > _TWO_STEPS * most or not _in_two_steps(row, j, k, near, most):
                return False
    return True


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _turned(row, k):
    # by how much a joint turns in grid interval k; it rests before and after the profile
    return row[k + 1] - row[k] if 0 <= k < len(row) - 1 else 0.0


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _in_two_steps(row, j, k, near, most):
    # whether intervals j and k of the profile are on two lines that last a ramp, and the step of
    # their mean velocity, half a ramp to either side, differs from what comes a ramp before it and
    # behind it by no more than the largest change
    same = _SAME * most
    before, after = _turned(row, j), _turned(row, k)
    change = j + 1
    while abs(_turned(row, change) - before) <= same:
        change += 1
    if change - near < 0 or change + near > len(row) - 1:
        return False
    mean, beyond = 0.5 * (before + after), near + (near + 1) // 2
    for at in range(change - beyond, change + beyond):
        turned = _turned(row, at)
        line = before if at < change else after
        if change - near <= at < change + near and abs(turned - line) > same:
            return False
        if abs(turned - mean) > most:
            return False
    return True
