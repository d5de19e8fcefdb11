# SPDX-License-Identifier: Apache-2.0
"""The least time in which a motor turns its joint by some angle, from rest to rest."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats
from fiber_core.drive.drive import Drive

__all__ = ["approach_s", "least_time_s"]

_STAYS_RAD = 1e-6  # a joint this near to its goal need not move: less than a step of any encoder


def least_time_s(drive: Drive, speed_rad_s: Floats, turn_rad: ArrayLike) -> Floats:
    """Return the least time that each joint is in motion for some turns, from rest to rest [s].

    Args:
        drive: how the motors of n robots carry out orders.
        speed_rad_s: highest speed of each joint [rad/s], shape (n, 2).
        turn_rad: signed turns of both joints [rad], shape (n, k, 2).

    Returns:
        Shape (n, k, 2); inf where the turn is not a number.
    """
    turn = np.asarray(turn_rad, dtype=np.float64)
    if drive.listed is not None:
        least = _with_listed_speeds(drive, turn)
        return np.where(np.isnan(turn), np.inf, np.where(np.abs(turn) < _STAYS_RAD, 0.0, least))
    speed, limit = speed_rad_s[:, None], drive.acceleration_rad_s2[:, None]
    turn = np.abs(turn)
    if np.isinf(limit).all():
        return np.where(np.isnan(turn), np.inf, turn / speed)
    rise_s = speed / limit
    least = np.where(turn < speed * rise_s, 2.0 * np.sqrt(turn / limit), turn / speed + rise_s)
    return np.where(np.isnan(turn), np.inf, least)


def approach_s(drive: Drive) -> Floats:
    """Return how long the approach of each joint takes, with the way back before it [s], (n, 2)."""
    listed = drive.listed
    if listed is None:
        return np.zeros((drive.n, 2))
    rising = (listed.approach_sign > 0.0).astype(np.int64)
    speed = listed.speeds_rad_s[listed.approach_speed]
    ramp_s = listed.ramp_s[listed.approach_speed]
    scale = drive.scale[:, [0, 1], rising]
    moves = listed.approach_rad / (speed * scale) + ramp_s
    if listed.returns:
        moves = moves + listed.approach_rad / (speed * drive.scale[:, [0, 1], 1 - rising]) + ramp_s
    return np.where(listed.approach_rad > 0.0, moves, 0.0)


def _with_listed_speeds(drive: Drive, turn: Floats) -> Floats:
    # A turn is some way ahead less some way back. Either is made at the fastest speed that is used
    # that way, at the earliest: by one move, which is no shorter than the least move of its speed,
    # ramp included. The approach comes after it; its two parts may be longer than they must be, for
    # no ramp and with no least move.
    listed = drive.listed
    assert listed is not None
    if not listed.returns:  # the approach is a part of the turn
        turn = turn - (listed.approach_sign * listed.approach_rad)
    scale = drive.scale[:, None]
    forth, back = scale[..., 1], scale[..., 0]
    ahead, behind = np.where(turn > 0.0, forth, back), np.where(turn > 0.0, back, forth)
    way, best = np.abs(turn), np.full(turn.shape, np.inf)
    without_ramp_s = np.where(listed.approach_rad > 0.0, 0.0, np.inf)
    longer = (listed.speeds_rad_s[listed.approach_speed], without_ramp_s, 0.0)
    moves = [*zip(listed.speeds_rad_s, listed.ramp_s, listed.least_rad), longer]
    for speed, ramp_s, least in moves:
        alone = np.where(way >= least * ahead, way / (speed * ahead) + ramp_s, np.inf)
        best = np.minimum(best, alone)
        for speed_back, ramp_back_s, least_back in moves:
            goes = np.maximum(way + least_back * behind, least * ahead)
            both_s = goes / (speed * ahead) + ramp_s + ramp_back_s
            best = np.minimum(best, both_s + (goes - way) / (speed_back * behind))
    return np.where(way < _STAYS_RAD, 0.0, best) + approach_s(drive)[:, None]
