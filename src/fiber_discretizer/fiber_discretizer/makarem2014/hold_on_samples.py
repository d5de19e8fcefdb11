# SPDX-License-Identifier: Apache-2.0
"""Choose the robots that rest where a planned trajectory brings robots too close."""

import numpy as np

from fiber_core.array_types import Ints, Mask, Pairs, Rows
from fiber_discretizer.makarem2014.free_space import FreeSpace, free_space_mm

__all__ = ["hold_on_samples"]


def hold_on_samples(free_space: FreeSpace) -> Mask:
    """Let robots rest at their start until no sample is too close, and return these robots.

    Shares of the free space cannot repair a trajectory in which robots meet. Robots are held
    in rounds: in each, every moving robot that ranks above all moving robots it meets. A
    robot that meets one at rest ranks first, because nothing else can help; then the robot
    that solves the most violated pairs by resting, less the pairs that it would block; then
    the lower row.

    Args:
        free_space: free space along the planned trajectory; changed: held robots rest in it.

    Returns:
        The robots held, shape (n,). Pairs that are too close although both rest remain so.
    """
    n, pairs = free_space.plane.n, free_space.pairs
    free = np.zeros(n + free_space.plane.fixtures, dtype=bool)
    free[:n] = np.any(free_space.angles != free_space.angles[:, :, :1], axis=(1, 2))
    held = np.zeros(n, dtype=bool)
    violated = np.zeros(len(pairs), dtype=bool)
    changed = np.ones(len(pairs), dtype=bool)
    while True:
        violated[changed] = free_space.space_mm(changed).min(axis=1) < 0.0
        meetings = pairs[violated & free[pairs].any(axis=1)]
        if len(meetings) == 0:
            return held
        chosen = np.zeros(n, dtype=bool)
        chosen[_foremost(meetings, free, free_space)] = True
        free_space.move(chosen, free_space.angles[chosen, :, :1])
        held |= chosen
        free[:n] &= ~chosen
        changed = free_space.pairs_with(chosen)


def _foremost(meetings: Pairs, free: Mask, free_space: FreeSpace) -> Rows:
    # rows of the free robots that rank above every free robot they meet
    candidates = np.unique(meetings[free[meetings]])
    score = np.bincount(meetings.ravel(), minlength=len(free))
    score[candidates] -= _blocked_pairs(candidates, free_space)
    unavoidable = meetings[~free[meetings].all(axis=1)].ravel()
    score[unavoidable] = len(free_space.pairs) + 1
    rank = np.where(free, score * len(free) - np.arange(len(free)), np.iinfo(np.int64).min)
    a, b = meetings.T
    return np.setdiff1d(candidates, np.where(rank[a] < rank[b], a, b))


def _blocked_pairs(candidates: Rows, free_space: FreeSpace) -> Ints:
    # number of neighbours that each candidate is too close to if it rests and they do not
    which = free_space.pairs_with(np.isin(np.arange(free_space.plane.n), candidates))
    pairs, required = free_space.pairs[which], free_space.required_mm[which]
    both_ways = np.concatenate([pairs, pairs[:, ::-1]])
    affected = np.isin(both_ways[:, 0], candidates)
    resting = np.repeat(free_space.angles[:, :, :1], free_space.angles.shape[2], axis=2)
    space = free_space_mm(
        free_space.plane,
        both_ways[affected],
        np.tile(required, 2)[affected],
        resting,
        free_space.angles,
    )
    blocked = both_ways[affected, 0][space.min(axis=1) < 0.0]
    return np.bincount(blocked, minlength=free_space.plane.n)[candidates]
