# SPDX-License-Identifier: Apache-2.0
"""The least time in which a motor turns its joint by some angle, from rest to rest."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats
from fiber_core.drive.drive import Drive

__all__ = ["approach_s", "least_time_s"]

_STAYS_RAD = 1e-6  # a joint this near to its goal need not move: less than a step of any encoder
_SAME_RAD = 1e-9  # beyond the range of a joint by less is inside it


def least_time_s(
    drive: Drive, speed_rad_s: Floats, turn_rad: ArrayLike, span_rad: ArrayLike | None = None
) -> Floats:
    """Return the least time that each joint is in motion for some turns, from rest to rest [s].

    With listed speeds it is exact where the speed of the approach has neither a ramp nor a least
    move, and the range of the joint is at least twice the longest least move; else it is a lower
    bound.

    Args:
        drive: how the motors of n robots carry out orders.
        speed_rad_s: highest speed of each joint [rad/s], shape (n, 2).
        turn_rad: signed turns of both joints [rad], shape (n, k, 2).
        span_rad: lowest and highest turn at which each joint is inside its range [rad], shape
            (n, 2, 2); by default there is no end of the range. It has an effect only on listed
            speeds, with which a joint turns beyond its start and its goal.

    Returns:
        Shape (n, k, 2); inf where the turn is not a number, and where no approach inside the range
        ends.
    """
    turn = np.asarray(turn_rad, dtype=np.float64)
    if drive.listed is not None:
        span = np.array([-np.inf, np.inf]) if span_rad is None else np.asarray(span_rad)
        span = np.broadcast_to(span, (drive.n, 2, 2))[:, None]
        least = _with_listed_speeds(drive, turn, span)
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


def _with_listed_speeds(drive: Drive, turn: Floats, span: Floats) -> Floats:
    # A turn is some way ahead less some way back. Either is made at the fastest speed that is used
    # that way, at the earliest: by one move, which is no shorter than the least move of its speed,
    # ramp included. The approach comes after it; its two parts may be longer than they must be, for
    # no ramp and with no least move.
    listed = drive.listed
    assert listed is not None
    before = turn - listed.approach_sign * listed.approach_rad  # where the last move begins
    outside = (before < span[..., 0] - _SAME_RAD) | (before > span[..., 1] + _SAME_RAD)
    if not listed.returns:  # the approach is a part of the turn
        turn = before
    scale = drive.scale[:, None]
    forth, back = scale[..., 1], scale[..., 0]
    up = turn > 0.0
    ahead, behind = np.where(up, forth, back), np.where(up, back, forth)
    # how far the joint may turn ahead, and back, of its start
    far = np.where(up, span[..., 1], -span[..., 0]) + _SAME_RAD
    near = np.maximum(np.where(up, -span[..., 0], span[..., 1]), 0.0) + _SAME_RAD
    narrow = far + near < 2.0 * listed.least_rad.max() * np.maximum(ahead, behind)
    way, best = np.abs(turn), np.full(turn.shape, np.inf)
    without_ramp_s = np.where(listed.approach_rad > 0.0, 0.0, np.inf)
    longer = (listed.speeds_rad_s[listed.approach_speed], without_ramp_s, 0.0)
    moves = [*zip(listed.speeds_rad_s, listed.ramp_s, listed.least_rad), longer]
    for speed, ramp_s, least in moves:
        alone = np.where(way >= least * ahead, way / (speed * ahead) + ramp_s, np.inf)
        best = np.minimum(best, alone)
        for speed_back, ramp_back_s, least_back in moves:
            goes = np.maximum(way + least_back * behind, least * ahead)
            comes = goes - way
            # ahead first, or back first; a way back in creep may be before and behind the other
            fits = narrow | (goes <= far) | (comes <= near)
            if least_back == 0.0:
                fits |= goes - far <= np.minimum(comes, near)
            both_s = goes / (speed * ahead) + ramp_s + ramp_back_s
            both_s = both_s + comes / (speed_back * behind)
            best = np.minimum(best, np.where(fits, both_s, np.inf))
    best = np.where(way < _STAYS_RAD, 0.0, best) + approach_s(drive)[:, None]
    return np.where(outside & (listed.approach_rad > 0.0), np.inf, best)
