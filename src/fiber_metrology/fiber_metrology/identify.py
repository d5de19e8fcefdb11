# SPDX-License-Identifier: Apache-2.0
"""Identification: which light is of which robot, and how sure that is.

Every robot has places where its fibre may be: where its counters say, where it would be if theta,
phi or both had not turned. A light near one of them is evidence e(robot, light), a density over the
plane. An assignment gives each robot one light or none, and its probability is proportional to

    prod_robots (e of the light that it has, or the chance that it shows none)
    x stray density ^ (number of lights that no robot has).

Robots and lights that share evidence make a group. In each group all assignments are summed, so
that the probability of each pair is exact; what is not above `certain` is not told as a fact.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.stats import binom

from fiber_core import bounds
from fiber_core.array_types import Floats, Ints, Mask, Points
from fiber_metrology.errors import MetrologyError

__all__ = ["Identified", "IdentifyConfig", "identify", "most_likely"]

_TAIL, _WIDER = 0.1, 3.0  # a tenth of the robots are off by three times the usual
_SIGMAS = 9.0  # beyond which a light is no evidence
_MOST = 200_000  # assignments of a group that are summed


@dataclass(frozen=True)
class IdentifyConfig:
    """What is known before the image.

    Args:
        none: chance that a fibre shows no light in one exposure: dark or missing.
        missed: chance that one exposure lacks a fibre that others show, or shows it merged.
        unmoved: chance that a joint, or both, did not turn.
        stray_per_mm2: stray lights that one exposure sees, in an area [1/mm2].
        lasting_per_mm2: stray lights that two exposures or more see [1/mm2].
        certain: a robot has a light for sure if all other assignments together are less likely
            than this.

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "none": bounds.Range(1e-9, 1.0),
        "missed": bounds.Range(1e-9, 0.5),
        "unmoved": bounds.Range(1e-9, 1.0),
        "stray_per_mm2": bounds.Range(1e-9, 1e3),
        "lasting_per_mm2": bounds.Range(1e-12, 1e3),
        "certain": bounds.Range(0.0, 0.5),
    }

    none: float = 0.1
    missed: float = 0.08
    unmoved: float = 0.01
    stray_per_mm2: float = 1e-4
    lasting_per_mm2: float = 1e-5
    certain: float = 1e-4

    def __post_init__(self) -> None:
        bounds.check_ranges(self, self.RANGES, MetrologyError)


class Identified(NamedTuple):
    """The light of each robot.

    Args:
        light: the likeliest light of each robot, -1 for none, shape (n,).
        doubt: probability of anything else, shape (n,).
        where: the likeliest of its places, the column of `places`, -1 without a light, shape (n,).
        first_place: probability that it is at the first of its places, given the light, shape (n,).
        group: robots that share lights have the same number, -1 for a robot alone, shape (n,).
    """

    light: Ints
    doubt: Floats
    where: Ints
    first_place: Floats
    group: Ints


def identify(
    places: ArrayLike,
    sigma_mm: ArrayLike,
    chance: ArrayLike,
    lights: ArrayLike,
    seen: ArrayLike = 1,
    exposures: int = 1,
    config: IdentifyConfig | None = None,
) -> Identified:
    """Find the light of each robot.

    Args:
        places: where each fibre may be [mm], shape (n, h, 2), nan for no such place.
        sigma_mm: error of each place along one axis [mm], shape (n, h).
        chance: chance that the robot is at each place, shape (n, h).
        lights: points of light [mm], shape (s, 2).
        seen: number of exposures that saw each light, one number or shape (s,).
        exposures: number of exposures: a fibre is seen in most of them.
        config: what is known before the image.
    """
    config = config or IdentifyConfig()
    places, sigma = np.asarray(places, dtype=float), np.asarray(sigma_mm, dtype=float)
    chance, lights = np.asarray(chance, dtype=float), np.asarray(lights, dtype=float)
    often = np.broadcast_to(np.asarray(seen), (len(lights),)) > 1
    stray = np.where(often, config.lasting_per_mm2, config.stray_per_mm2)
    # dark, or lacking in every exposure
    none = max(config.none - config.missed, 0.0) + config.missed**exposures
    n, h = sigma.shape
    light, where = np.full(n, -1), np.full(n, -1)
    doubt, first_place, group = np.ones(n), np.zeros(n), np.full(n, -1)
    row, column = np.nonzero(np.isfinite(places).all(axis=2))
    if len(lights) and len(row):
        near = cKDTree(lights).query_ball_point(places[row, column], _SIGMAS * sigma[row, column])
        count = np.array([len(each) for each in near])
        spot = np.array([k for each in near for k in each], dtype=np.int64)
    else:
        count, spot = np.zeros(len(row), dtype=np.int64), np.zeros(0, dtype=np.int64)
    row, column = np.repeat(row, count), np.repeat(column, count)
    evidence = _evidence(places[row, column], sigma[row, column], lights[spot])
    evidence *= chance[row, column] * _share_seen(seen, exposures, config.missed, len(lights))[spot]
    # one edge for a robot and a light, whichever of its places the light is near
    order = np.lexsort([spot, row])
    row, column, spot, evidence = row[order], column[order], spot[order], evidence[order]
    new = np.ones(len(row), dtype=bool)
    new[1:] = (np.diff(row) != 0) | (np.diff(spot) != 0)
    edge = np.cumsum(new) - 1
    total = np.bincount(edge, evidence)
    best = _largest(edge, evidence, int(new.sum()))
    of_first = np.bincount(edge, np.where(column == 0, evidence, 0.0), len(total))
    edges = (row[new], spot[new], total)
    chosen, likely, alone, part = _solved(
        edges[0], edges[1], total / stray[edges[1]], n, len(lights), none
    )
    light[chosen >= 0] = edges[1][chosen[chosen >= 0]]
    doubt = likely
    has = np.flatnonzero(chosen >= 0)
    where[has] = column[best[chosen[has]]]
    first_place[has] = of_first[chosen[has]] / total[chosen[has]]
    shared = np.zeros(n, dtype=bool)
    shared[edges[0]] = True
    group = np.where(shared & ~alone, part[:n], -1)
    return Identified(light, doubt, where, first_place, group)


def most_likely(
    row: Ints, light: Ints, weight: Floats, n: int, lights: int, none: float
) -> tuple[Ints, Floats]:
    """Sum all assignments of lights to robots, and return the likeliest of each robot.

    Args:
        row: robot of each pair that has evidence, in increasing order, shape (p,).
        light: light of each pair, shape (p,).
        weight: density of the evidence over that of a stray light there, shape (p,).
        n: number of robots.
        lights: number of lights.
        none: chance that a robot shows no light.

    Returns:
        The light of each robot, -1 for none, and the probability of anything else, shape (n,).
    """
    chosen, doubt, _, _ = _solved(row, light, weight, n, lights, none)
    return np.where(chosen >= 0, light[np.maximum(chosen, 0)] if len(light) else -1, -1), doubt


def _solved(
    row: Ints, light: Ints, weight: Floats, n: int, lights: int, none: float
) -> tuple[Ints, Floats, Mask, Ints]:
    """What `_solve` returns, and the number of the group of each robot and light."""
    part = _components(row, light, n, lights)
    order = np.argsort(part[row], kind="stable")
    _, first = np.unique(part[row][order], return_index=True)
    groups = np.append(first, len(order))
    return *_solve(row, light, weight, order, groups, none, n), part


def _share_seen(seen: ArrayLike, exposures: int, missed: float, lights: int) -> Floats:
    """Chance that a fibre is seen so often, over that of the likeliest number, shape (lights,)."""
    often = np.broadcast_to(np.asarray(seen), (lights,))
    numbers = np.arange(exposures + 1)
    chance = binom.pmf(numbers, exposures, 1.0 - missed)
    return chance[np.minimum(often, exposures)] / chance.max()


def _evidence(places: Points, sigma: Floats, lights: Points) -> Floats:
    """Density of a light at a distance from a place: a normal one with a wider tail [1/mm2]."""
    far = ((places - lights) ** 2).sum(axis=1) / (2.0 * sigma**2)
    core = (1.0 - _TAIL) * np.exp(-far)
    tail = _TAIL / _WIDER**2 * np.exp(-far / _WIDER**2)
    return (core + tail) / (2.0 * math.pi * sigma**2)


def _largest(edge: Ints, evidence: Floats, edges: int) -> Ints:
    """The row with the largest evidence of each edge, shape (edges,)."""
    order = np.lexsort([-evidence, edge])
    return order[np.searchsorted(edge[order], np.arange(edges))]


def _components(row: Ints, spot: Ints, n: int, s: int) -> Ints:
    """Number of the group of each robot and light, shape (n + s,)."""
    size = n + s
    graph = coo_array((np.ones(len(row)), (row, n + spot)), shape=(size, size))
    return connected_components(graph, directed=False)[1]


@nb.njit(cache=True)
def _solve(row, spot, weight, order, groups, none, n):
    """Sum the assignments of every group.

    Returns the likeliest edge of each robot, -1 for none, the probability of anything else, and
    whether the robot shares no light, shape (n,) each. An edge weighs its evidence over the density
    of stray lights, no light weighs `none`: lights are strays before they are given away.
    """
    chosen, alone = np.full(n, -1), np.ones(n, dtype=np.bool_)
    doubt = np.zeros(n)  # of a robot without a light near it: it has none
    for g in range(len(groups) - 1):
        edges = order[groups[g] : groups[g + 1]]
        # edges of a robot are neighbours, as rows are sorted and the order is stable
        first, size = [0], 1.0
        for k in range(1, len(edges) + 1):
            if k == len(edges) or row[edges[k]] != row[edges[k - 1]]:
                size *= k - first[-1] + 1
                first.append(k)
        robots = len(first) - 1
        for r in range(robots):
            alone[row[edges[first[r]]]] = robots == 1
            doubt[row[edges[first[r]]]] = 1.0
        if size > _MOST:
            continue  # all of them are ambiguous
        of_edge, of_none, whole = _sums(spot[edges], weight[edges], np.array(first), none)
        for r in range(robots):
            i, best = row[edges[first[r]]], -1
            for k in range(first[r], first[r + 1]):
                if of_edge[k] > (of_none[r] if best < 0 else of_edge[best]):
                    best = k
            chosen[i] = -1 if best < 0 else edges[best]
            # the sum of the others, not one minus the largest: small doubts keep their digits
            rest = 0.0 if best < 0 else of_none[r]
            for k in range(first[r], first[r + 1]):
                if k != best:
                    rest += of_edge[k]
            doubt[i] = rest / whole
    return chosen, doubt, alone


@nb.njit(cache=True)
def _sums(spot, weight, first, none):
    """Sum the products of all assignments of a group: by edge, by robot without light, and all."""
    robots = len(first) - 1
    of_edge, of_none, whole = np.zeros(len(spot)), np.zeros(robots), 0.0
    choice = np.zeros(robots, dtype=np.int64)  # 0 for none, k for edge first + k - 1
    while True:
        product = 1.0
        for r in range(robots):
            edge = first[r] + choice[r] - 1
            product *= none if choice[r] == 0 else weight[edge]
            for q in range(r):
                if choice[r] and choice[q] and spot[first[q] + choice[q] - 1] == spot[edge]:
                    product = 0.0  # two robots have one light
        whole += product
        for r in range(robots):
            if choice[r] == 0:
                of_none[r] += product
            else:
                of_edge[first[r] + choice[r] - 1] += product
        r = 0
        while r < robots and choice[r] == first[r + 1] - first[r]:
            choice[r] = 0
            r += 1
        if r == robots:
            return of_edge, of_none, whole
        choice[r] += 1
