"""Decide who stays at rest where a planned trajectory lets robots meet."""

import numpy as np

from fiber_discretizer.makarem2014.free_space import FreeSpace, free_space_mm

__all__ = ["hold_on_samples"]


def hold_on_samples(free_space: FreeSpace) -> np.ndarray:
    """Let robots rest at their start until no sample is too close, and return which.

    Margins cannot repair a trajectory in which robots meet. Robots are held in rounds:
    in each, every moving robot that ranks above all moving robots it meets. Whoever
    meets a robot at rest ranks first, because nothing else can help; then whoever solves
    the most violated pairs by resting, less those it would be in the way of; then the
    lower row.

    Args:
        free_space: free space along the planned trajectory; the robots held are moved in it.

    Returns:
        The robots held, shape (n,). Pairs that are too close although both rest remain so.
    """
    n, pairs = free_space.plane.n, free_space.pairs
    free = np.zeros(n + len(free_space.plane.obstacles), dtype=bool)
    free[:n] = np.any(free_space.angles != free_space.angles[:, :, :1], axis=(1, 2))
    held = np.zeros(n, dtype=bool)
    violated = np.zeros(len(pairs), dtype=bool)
    doubtful = np.ones(len(pairs), dtype=bool)
    while True:
        violated[doubtful] = free_space.space_mm(doubtful).min(axis=1) < 0.0
        meetings = pairs[violated & free[pairs].any(axis=1)]
        if len(meetings) == 0:
            return held
        chosen = np.zeros(n, dtype=bool)
        chosen[_foremost(meetings, free, free_space)] = True
        free_space.move(chosen, free_space.angles[chosen, :, :1])
        held |= chosen
        free[:n] &= ~chosen
        doubtful = free_space.touching(chosen)


def _foremost(meetings, free, free_space):
    # rows of the free robots that rank above every free robot they meet
    candidates = np.unique(meetings[free[meetings]])
    score = np.bincount(meetings.ravel(), minlength=len(free))
    score[candidates] -= _in_the_way(candidates, free_space)
    hopeless = meetings[~free[meetings].all(axis=1)].ravel()
    score[hopeless] = len(free_space.pairs) + 1
    rank = np.where(free, score * len(free) - np.arange(len(free)), np.iinfo(np.int64).min)
    a, b = meetings.T
    return np.setdiff1d(candidates, np.where(rank[a] < rank[b], a, b))


def _in_the_way(candidates, free_space):
    # how many neighbours each candidate is too close to if it rests and they do as planned
    which = free_space.touching(np.isin(np.arange(free_space.plane.n), candidates))
    pairs, required = free_space.pairs[which], free_space.required_mm[which]
    both_ways = np.concatenate([pairs, pairs[:, ::-1]])
    mine = np.isin(both_ways[:, 0], candidates)
    resting = np.repeat(free_space.angles[:, :, :1], free_space.angles.shape[2], axis=2)
    space = free_space_mm(
        free_space.plane, both_ways[mine], np.tile(required, 2)[mine], resting, free_space.angles
    )
    blocked = both_ways[mine, 0][space.min(axis=1) < 0.0]
    return np.bincount(blocked, minlength=free_space.plane.n)[candidates]
