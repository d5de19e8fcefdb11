# SPDX-License-Identifier: Apache-2.0
"""The random number generator of the local search: splitmix64 (Steele, Lea, Flood, OOPSLA 2014)."""

from typing import TypeAlias

import numba as nb
import numpy as np
from numpy.typing import NDArray

from fiber_core.focal_plane import FocalPlane

__all__ = ["RngState", "next_uniform", "place_keys", "seeded_rng"]

RngState: TypeAlias = NDArray[np.uint64]  # state of a generator, shape (1,)

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_SECOND = np.uint64(0xD1B54A32D192ED03)  # an odd number that tells the two coordinates apart
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


@nb.njit(cache=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
def _mix(z):
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    return z ^ (z >> _S31)


@nb.njit(cache=True)
def seeded_rng(key: np.uint64, round_: int) -> RngState:
    """Return the state of a random number generator.

    Args:
        key: number of the robot, from place_keys.
        round_: other numbers give other sequences.
    """
    rng = np.empty(1, dtype=np.uint64)
    rng[0] = _mix(key + (np.uint64(round_) + np.uint64(1)) * _GOLDEN)
    return rng


@nb.njit(cache=True)
def next_uniform(rng: RngState) -> float:
    """Return the next number in [0, 1)."""
    rng[0] = rng[0] + _GOLDEN
    return float(_mix(rng[0]) >> _S11) * (1.0 / 9007199254740992.0)


def place_keys(plane: FocalPlane, seed: int) -> NDArray[np.uint64]:
    """Return a number per robot that depends only on its place and a seed, shape (n,).

    Args:
        plane: the focal plane.
        seed: of the random numbers.
    """
    bits = np.ascontiguousarray(plane.centers + 0.0).view(np.uint64)  # + 0.0: no minus zero
    return _keys(bits, np.uint64(seed))


@nb.njit(cache=True)
def _keys(bits, seed):
    keys = np.empty(len(bits), dtype=np.uint64)
    for i in range(len(bits)):
        keys[i] = _mix(_mix(bits[i, 0] + seed * _GOLDEN) ^ (bits[i, 1] * _SECOND))
    return keys
