# SPDX-License-Identifier: Apache-2.0
"""Random motions that robots in conflict try: other times, angles on the way, elbows and turns."""

from typing import NamedTuple

import numpy as np

from fiber_core.array_types import Counts, Floats, Ints, Mask, Rows
from fiber_planner.scheduled.moves import Motors, jogs
from fiber_planner.scheduled.orders import Legs, legs_by_way_of
from fiber_planner.scheduled.timetable import (
    LEGS,
    PHI_APPROACH,
    PHI_RUN,
    PHI_VIA,
    THETA_APPROACH,
    THETA_RUN,
    THETA_VIA,
)

__all__ = ["Candidates", "draw"]

_OTHER = 0.3  # share of candidates with any elbow and turn
_STRAIGHT = 0.3  # share without an angle on the way
_IN_TURN = 0.4  # share in which phi folds, theta turns and phi unfolds one after the other
_AROUND = 0.3  # share in which theta goes to an angle on the way


class Candidates(NamedTuple):
    """Motions that robots may make instead of their own; a robot may be there several times.

    Args:
        rows: their robots, shape (m,).
        legs: their moves.
        wanted: earliest tick of each leg, shape (m, 6).
        turn: how far their joints turn in them [quanta], shape (m, 2).
        freed: whether the robot has another end than its target, shape (m,).
    """

    rows: Rows
    legs: Legs
    wanted: Ints
    turn: Ints
    freed: Mask

    def take(self, kept: Ints) -> "Candidates":
        """Return some of them, shape (k,)."""
        legs = self.legs.take(kept)
        rows, wanted, turn = self.rows[kept], self.wanted[kept], self.turn[kept]
        return Candidates(rows, legs, wanted, turn, self.freed[kept])


def draw(
    rng: np.random.Generator,
    motors: Motors,
    rows: Rows,
    start: Counts,
    turn: Ints,
    others: Ints,
    ticks: int,
    freed: Rows,
) -> Candidates:
    """Return random motions of some robots.

    Args:
        rng: random numbers.
        motors: what the motors can do.
        rows: the robots, shape (m,); each is there as often as it has motions.
        start: positions of all robots at time zero [quanta], shape (n, 2).
        turn: how far the joints of all robots turn now [quanta], shape (n, 2).
        others: all turns that bring each robot to its target [quanta], shape (n, k, 2).
        ticks: length of the timetable.
        freed: robots that may end anywhere, shape (r,); the first motion of each is to rest.
    """
    m, k = len(rows), others.shape[1]
    u = rng.random((m, 12))
    at, turns = start[rows], turn[rows]
    other = others[rows, np.minimum((u[:, 7] / _OTHER * k).astype(np.int64), k - 1)]
    turns = np.where((u[:, 7] < _OTHER)[:, None], other, turns)
    turned_last = u[:, 8] < 0.5
    via = _ways(motors, rows, at, turns, turned_last, u)
    legs = legs_by_way_of(motors, rows, at, turns, via)
    orderly = _in_turn(legs.on, turned_last, u, ticks)
    in_turn = u[:, 1] < _IN_TURN
    wanted = np.where(in_turn[:, None], orderly, _any_time(legs.on, u, ticks))
    away = _anywhere(rng, motors, freed, start)
    r = len(freed)
    return Candidates(
        np.concatenate([rows, freed]),
        legs.joined(away),
        np.concatenate([wanted, np.zeros((r, LEGS), dtype=np.int64)]),
        np.concatenate([turns, turn[freed]]),
        np.arange(m + r) >= m,
    )


def _anywhere(rng: np.random.Generator, motors: Motors, rows: Rows, start: Counts) -> Legs:
    # runs to any angles, phi rather inward; the first ones of each robot are rests
    low, high = np.moveaxis(motors.ranges[rows], -1, 0)
    at = start[rows]
    u = rng.random((len(rows), 2))
    u[:, 1] = np.sqrt(u[:, 1])
    turn = (low + u * (high - low)).astype(np.int64) - at
    turn *= rng.random((len(rows), 2)) < 0.7
    turn[np.unique(rows, return_index=True)[1]] = 0
    return legs_by_way_of(motors, rows, at, turn, np.zeros_like(turn))


def _ways(
    motors: Motors, rows: Rows, start: Counts, turn: Ints, turned_last: Mask, u: Floats
) -> Ints:
    # How far joints turn first [quanta]: phi further in than at both ends; theta away from the
    # start or beyond the goal, to be where phi can fold or unfold; near goals by two runs.
    via = np.where(u[:, [9]] < 0.5, jogs(motors, rows, turn), 0)
    ends = np.maximum(start[:, 1], start[:, 1] + turn[:, 1])
    inward = np.maximum(motors.ranges[rows, 1, 1] - ends, 0)
    folded = (ends + u[:, 0] * inward).astype(np.int64) - start[:, 1]
    via[:, 1] = np.where(u[:, 1] > 1.0 - _STRAIGHT, via[:, 1], folded)
    quarter = (motors.ranges[rows, 0, 1] - motors.ranges[rows, 0, 0]) // 4
    away = np.where(turned_last, turn[:, 0], 0) + (2.0 * u[:, 11] - 1.0) * quarter
    low, high = (motors.ranges[rows, 0] - start[:, :1]).T
    away = np.clip(away.astype(np.int64), low, high)
    via[:, 0] = np.where(u[:, 10] < _AROUND, away, via[:, 0])
    return via


def _in_turn(on: Ints, turned_last: Mask, u: Floats, ticks: int) -> Ints:
    # When the legs want to begin: one after another from some instant on. Theta goes first or last.
    wanted = np.zeros_like(on)
    spare = ticks - on.sum(axis=1) + on[:, THETA_APPROACH]
    first = (u[:, 2] * u[:, 3] * np.maximum(spare, 0)).astype(np.int64)
    for at, moves in (
        (turned_last, [PHI_VIA, THETA_VIA, PHI_RUN, THETA_RUN]),
        (~turned_last, [THETA_VIA, PHI_VIA, THETA_RUN, PHI_RUN]),
    ):
        before = np.cumsum(on[:, moves], axis=1) - on[:, moves]
        wanted[:, moves] = np.where(at[:, None], first[:, None] + before, wanted[:, moves])
    return wanted


def _any_time(on: Ints, u: Floats, ticks: int) -> Ints:
    # when the legs want to begin: each at some instant, many at the first that is possible
    wanted = np.zeros_like(on)
    for leg, after, k, early in (
        (PHI_VIA, PHI_RUN, 2, 0.6),
        (THETA_RUN, THETA_APPROACH, 3, 0.2),
        (PHI_RUN, PHI_APPROACH, 4, 0.1),
    ):
        share = np.maximum(u[:, k] - early, 0.0) / (1.0 - early)
        wanted[:, leg] = share * np.maximum(ticks - on[:, leg] - on[:, after], 0)
    for leg, k in ((THETA_APPROACH, 5), (PHI_APPROACH, 6)):
        share = np.maximum(u[:, k] - 0.5, 0.0) / 0.5
        wanted[:, leg] = share * np.maximum(ticks - on[:, leg], 0)
    return wanted
