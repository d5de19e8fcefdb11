# SPDX-License-Identifier: Apache-2.0
"""Which robot of a pair that starts too close has to wait: that one whose turns bring it nearer."""

import math

import numba as nb
import numpy as np

from fiber_core.array_types import Bools
from fiber_core.clearance import pair_gap, pair_gap_below
from fiber_planner.direct.scene import Scene

__all__ = ["robots_that_wait"]

_WAYS = 16  # ratios of both joints that are tried, all around
_FIRST_RAD, _GROWTH = 5e-5, 1.25  # of the steps of a way: half a micrometre at first
_FURTHEST_RAD = 0.6
_NEARER_MM = 1e-3  # that the certificate grants: the resolution of a gap


def robots_that_wait(scene: Scene, margin_mm: float) -> Bools:
    """Return the robots of pairs that start too close which only the other robot can part, (b,).

    Of such a pair one robot rests and the other leaves, and the gap may not become smaller on its
    way. An arm whose side is touched can turn as it likes and comes nearer first, or for good.

    Args:
        scene: the robots and their surroundings.
        margin_mm: gap that a pair keeps once it has parted [mm].
    """
    waits = np.zeros(len(scene.movable), dtype=bool)
    both = scene.pairs[scene.movable[scene.pairs].all(axis=1)]
    for a, b in both[_nearer_than(scene, both, margin_mm)]:
        a_parts, b_parts = _parts(scene, a, b, margin_mm), _parts(scene, b, a, margin_mm)
        waits[a] |= b_parts and not a_parts
        waits[b] |= a_parts and not b_parts
    return waits


@nb.njit(cache=True)
def _nearer_than(scene, pairs, margin_mm):
    near = np.zeros(len(pairs), dtype=np.bool_)
    for p in range(len(pairs)):
        a, b = pairs[p]
        near[p] = pair_gap_below(
            scene.bodies, a, b, scene.start[a, 0], scene.start[a, 1],
            scene.start[b, 0], scene.start[b, 1], margin_mm,
        ) < margin_mm  # fmt: skip
    return near


@nb.njit(cache=True)
def _parts(scene, i, j, margin_mm):
    # Whether robot i, on one of some straight ways, gets as far as the margin from robot j, which
    # rests, and never nearer than it starts.
    theta, phi = scene.start[i]
    theta_j, phi_j = scene.start[j]
    least = pair_gap(scene.bodies, i, j, theta, phi, theta_j, phi_j) - _NEARER_MM
    for way in range(_WAYS):
        angle = 2.0 * math.pi * way / _WAYS
        turn = _FIRST_RAD
        while turn < _FURTHEST_RAD:
            q = (theta + turn * math.cos(angle), phi + turn * math.sin(angle))
            if not (scene.low[i, 0] <= q[0] <= scene.high[i, 0]):
                break
            if not (scene.low[i, 1] <= q[1] <= scene.high[i, 1]):
                break
            gap = pair_gap_below(scene.bodies, i, j, q[0], q[1], theta_j, phi_j, margin_mm)
            if gap < least:
                break
            if gap >= margin_mm:
                return True
            turn *= _GROWTH
    return False
