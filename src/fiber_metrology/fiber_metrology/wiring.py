# SPDX-License-Identifier: Apache-2.0
"""Which order moves which fibre: swapped robots and lost ones, from images of code words.

The light of a robot moves to and fro with the bits of its word. Of every light the movement along
every word is fitted (a matched filter); what it should be there follows from the place of the
light, the theta axis of the robot that may carry it, and the turn of phi: at right angles to the
phi arm, with some of the way lost. A robot at its own place is the usual case; a robot that moves a
light at the place of another one is swapped. Orders of phi may also turn it the other way, or turn
theta. All assignments of lights to robots are summed as in `identify`, so that the doubt about each
is a probability.

That is a probability among the explanations that are known. So what is told must pass four tests
besides: the best explanation fits the movement, no other light moves by the same word, no other
robot seems to move the same arm, and no light that is not explained is in the reach of that arm.
Of a robot that moves the arm of another one it is told only if it is told what that one moves.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from scipy.spatial import cKDTree
from scipy.stats import chi2

from fiber_core import bounds
from fiber_core.array_types import Bools, Floats, Ints, Points
from fiber_core.focal_plane import FocalPlane
from fiber_metrology.code_words import CodeWords
from fiber_metrology.errors import MetrologyError
from fiber_metrology.exposures import Lights
from fiber_metrology.identify import most_likely
from fiber_metrology.wiring_answer import Wiring, WiringVerdict

__all__ = ["WiringConfig", "tell_wiring"]

_CHUNK = 256  # lights whose movement along all words is fitted at once
_LARGEST = 600.0  # of a logarithm of evidence
_RIVALS = 30.0  # evidence so far below that of the best word of a light is none
_LEAST, _SMALL = 1e-6, 1e-10  # evidence that is none; beside that of a better pair
_MISFIT = 1e-4  # chance of what the best explanation leaves of a movement
_LENGTHS = 0.02  # of a movement that errors of arm lengths may leave
_ODD = 1e-6  # chance of what a word leaves of the movement of its own light
_TRACK_MM = 0.06  # a light is the one nearest to where it was first, within
_LEAST_IMAGES = 4  # with the bit, and without, in which a light must be seen


_HOWS = np.array([WiringVerdict.IN_PLACE, WiringVerdict.REVERSED, WiringVerdict.OTHER_JOINT])


@dataclass(frozen=True)
class WiringConfig:
    """What is known of camera, drives and wiring.

    Args:
        error_um: rms error of one coordinate of a place in one image [um].
        least: least share of a turn that the arm makes, the rest being lost motion.
        swapped: chance that a robot is at the place of another one.
        miswired: chance that orders of phi turn it the other way, and that they turn theta.
        none: chance that no light follows the word of a robot.
        stray_per_mm2: lights of no robot [1/mm2].
        certain: what is told has less doubt than this.

    Raises:
        MetrologyError: a value is out of range; names it.
    """

    RANGES: ClassVar = {
        "error_um": bounds.Range(1e-3, 1e3),
        "least": bounds.Range(0.0, 1.0),
        "swapped": bounds.Range(1e-9, 0.5),
        "miswired": bounds.Range(1e-9, 0.5),
        "none": bounds.Range(1e-9, 0.5),
        "stray_per_mm2": bounds.Range(1e-9, 1e3),
        "certain": bounds.Range(0.0, 0.5),
    }

    error_um: float = 4.5
    least: float = 0.3
    swapped: float = 1e-3
    miswired: float = 1e-5
    none: float = 0.1
    stray_per_mm2: float = 1e-3
    certain: float = 1e-4

    def __post_init__(self) -> None:
        bounds.check_ranges(self, self.RANGES, MetrologyError)


class _Fits(NamedTuple):
    # movement of a light along a word: its light, robot, and the movement [mm] with the sum of
    # squares of the word about its mean
    light: Ints
    row: Ints
    moved: Points
    squares: Floats


class _Pairs(NamedTuple):
    # explanations of the movement of a light: robot, light, robot about whose axis it moves, how
    # (IN_PLACE, REVERSED or OTHER_JOINT), evidence over that of a light of no robot, chance of such
    # a movement at rest, and what is left of it: chi2 with 2 degrees of freedom
    row: Ints
    light: Ints
    at: Ints
    how: Ints
    weight: Floats
    rest: Floats
    left: Floats


def tell_wiring(
    plane: FocalPlane,
    words: CodeWords,
    images: Sequence[Lights],
    config: WiringConfig | None = None,
) -> Wiring:
    """Tell which robot each order moves, from images of code words.

    Args:
        plane: the focal plane; where its robots stand need not be known.
        words: what the robots were told.
        images: the lights of each image; those of an image may lack some.
        config: what is known of camera, drives and wiring.

    Raises:
        MetrologyError: the words are not of this plane, or of other images.
    """
    config = config or WiringConfig()
    if words.bits.shape != (plane.n, len(images)):
        raise MetrologyError(
            f"words of {words.bits.shape[0]} robots and {words.images} images, "
            f"for {plane.n} robots and {len(images)} images"
        )
    places = _tracks(images)
    fits, word = _fits(words, places, config)
    lights = np.bincount(word[word >= 0], minlength=plane.n)
    pairs = _evidence(plane, words, places, fits, config)
    found, doubt, best = _likeliest(pairs, plane.n, len(places), config)
    # robots of which a light moves by the word, and of which that says nothing
    odd = lights > np.where(found >= 0, 1, 0)
    odd[found >= 0] |= pairs.left[best[found >= 0]] > chi2.isf(_MISFIT, 2)
    doubt[odd] = 1.0
    # an arm carries one fibre, so that of two robots which seem to move it neither is told
    likely = np.where(found >= 0, pairs.at[best] if len(pairs.at) else -1, -1)
    twice = (found >= 0) & (np.bincount(likely[found >= 0], minlength=plane.n)[likely] > 1)
    doubt[twice] = 1.0
    turned = words.turn_rad.any(axis=1)
    doubt[~turned] = 1.0
    told = np.where((found >= 0) & (doubt <= config.certain), likely, -1)
    _drop_open(told, doubt)
    contested = _in_reach(plane, places[(word >= 0) & (told[word] < 0)])
    doubt[(told >= 0) & contested[told]] = 1.0
    told[doubt > config.certain] = -1
    _drop_open(told, doubt)
    spot = np.full((plane.n, 2), np.nan)
    for robot in np.flatnonzero(told >= 0):
        spot[robot] = _middle(words.bits[robot], places[found[robot]])
    verdict = np.full(plane.n, WiringVerdict.NOT_SEEN)
    verdict[(found >= 0) | (doubt > 0.5)] = WiringVerdict.AMBIGUOUS
    row = np.flatnonzero(told >= 0)
    how = pairs.how[best[row]]
    moved = np.where(told[row] == row, WiringVerdict.IN_PLACE, WiringVerdict.SWAPPED)
    verdict[row] = np.where(how == WiringVerdict.IN_PLACE, moved, how)
    verdict[~turned] = WiringVerdict.NOT_TURNED
    # a light that rests: of a joint that is stuck, a robot that does not answer, or of no robot
    rests = (word < 0) & (np.isfinite(places[:, :, 0]).mean(axis=1) >= 0.5)
    return Wiring(verdict, told, spot, doubt, lights, _in_reach(plane, places[rests]))


def _drop_open(told: Ints, doubt: Floats) -> None:
    """Tell nothing of robots that move the arm of one of which it is not told what it moves."""
    while (bad := (told >= 0) & (told[told] < 0)).any():
        told[bad], doubt[bad] = -1, 1.0


def _in_reach(plane: FocalPlane, places: Floats) -> Bools:
    """Robots that may carry one of the lights, (n,), by its places in all images."""
    if not len(places):
        return np.zeros(plane.n, dtype=bool)
    apart = cKDTree(np.nanmean(places, axis=1)).query(plane.centers)[0]
    return np.asarray(apart <= plane.arms.sum(axis=1) + _TRACK_MM)


def _likeliest(
    pairs: _Pairs, n: int, lights: int, config: WiringConfig
) -> tuple[Ints, Floats, Ints]:
    """Light of each robot, -1 for none, the doubt, and the best explanation of it, (n,) each."""
    pair, first, owner = np.unique(
        np.stack([pairs.row, pairs.light]), axis=1, return_index=True, return_inverse=True
    )
    owner = owner.ravel()
    total = np.zeros(len(first))
    np.add.at(total, owner, pairs.weight)
    found, doubt = most_likely(pair[0], pair[1], total, n, lights, config.none)
    order = np.lexsort([-pairs.weight, owner])
    likeliest = order[np.unique(owner[order], return_index=True)[1]]
    of_pair = {(int(r), int(k)): i for i, (r, k) in enumerate(pair.T)}
    best = np.zeros(n, dtype=np.int64)
    for robot in np.flatnonzero(found >= 0):
        i = of_pair[int(robot), int(found[robot])]
        best[robot] = likeliest[i]
        doubt[robot] += 1.0 - pairs.weight[likeliest[i]] / total[i]
        doubt[robot] += pairs.rest[likeliest[i]]
    doubt = np.minimum(doubt, 1.0)
    return found, doubt, best


def _middle(bits: Bools, places: Points) -> Points:
    return np.asarray(np.nanmean(places[~bits], axis=0) + np.nanmean(places[bits], axis=0)) / 2.0


def _tracks(images: Sequence[Lights]) -> Floats:
    """Places of each light in all images [mm], nan where it was not seen, shape (s, images, 2)."""
    first = np.zeros((0, 2))
    for image in images:
        here = image.places[~image.merged]
        new = np.ones(len(here), dtype=bool)
        if len(first) and len(here):
            new = ~(cKDTree(first).query(here)[0] <= 2.0 * _TRACK_MM)
        first = np.concatenate([first, here[new]])
    places = np.full((len(first), len(images), 2), np.nan)
    for k, image in enumerate(images):
        here = image.places[~image.merged]
        if not len(here):
            continue
        apart, at = cKDTree(first).query(here)
        back = cKDTree(here).query(first)[1]
        kept = (apart <= _TRACK_MM) & (back[at] == np.arange(len(here)))
        places[at[kept], k] = here[kept]
    return places


def _fits(words: CodeWords, places: Floats, config: WiringConfig) -> tuple[_Fits, Ints]:
    """The movement of lights along words that explain most of it, and the word of each, or -1."""
    bits, found = words.bits.astype(float), []
    word = np.full(len(places), -1)
    # no light at rest seems to move by any of the words
    moves = np.log(max(len(bits) * len(places), 1) / max(config.certain, 1e-300))
    for begin in range(0, len(places), _CHUNK):
        part = places[begin : begin + _CHUNK]
        seen = np.isfinite(part[:, :, 0]).astype(float)
        middle = np.nan_to_num(np.nanmean(np.where(seen[:, :, None] > 0, part, np.nan), axis=1))
        off = np.where(seen[:, :, None] > 0, part - middle[:, None], 0.0)
        count, ones = seen.sum(axis=1)[:, None], seen @ bits.T
        squares = ones - ones**2 / np.maximum(count, 1.0)
        enough = np.minimum(ones, count - ones) >= _LEAST_IMAGES
        # the places are about their mean, so that the bits need no mean
        moved = np.stack([off[:, :, axis] @ bits.T for axis in range(2)], axis=-1)
        moved /= np.maximum(squares, 1e-9)[:, :, None]
        gain = (moved**2).sum(axis=2) * squares / (2.0 * (1e-3 * config.error_um) ** 2)
        gain = np.where(enough, gain, -np.inf)
        most = gain.max(axis=1, keepdims=True)
        word[begin : begin + _CHUNK] = np.where(most[:, 0] > moves, gain.argmax(axis=1), -1)
        # a light that moves by no word of the plane is of none of its robots
        left = (off**2).sum(axis=(1, 2)) / (1e-3 * config.error_um) ** 2 - 2.0 * most[:, 0]
        own = left <= chi2.isf(_ODD, np.maximum(2.0 * count[:, 0] - 4.0, 1.0))
        light, row = np.nonzero((gain > most - _RIVALS) & own[:, None])
        found.append((light + begin, row, moved[light, row], squares[light, row]))
    if not found:
        none = np.zeros(0, dtype=np.int64)
        return _Fits(none, none, np.zeros((0, 2)), np.zeros(0)), word
    return _Fits(*(np.concatenate(each) for each in zip(*found))), word


def _evidence(
    plane: FocalPlane, words: CodeWords, places: Floats, fits: _Fits, config: WiringConfig
) -> _Pairs:
    """What may move each light, by robot."""
    middle = np.nanmean(places, axis=1) if len(places) else np.zeros((0, 2))
    reach = plane.arms.sum(axis=1) + _TRACK_MM
    tree = cKDTree(plane.centers)
    near = tree.query_ball_point(middle, reach.max()) if len(middle) else []
    count = np.array([len(near[k]) for k in fits.light], dtype=np.int64)
    fit = np.repeat(np.arange(len(fits.light)), count)
    at = np.array([q for k in fits.light for q in near[k]], dtype=np.int64)
    arm = middle[fits.light[fit]] - plane.centers[at]
    row, light = fits.row[fit], fits.light[fit]
    turn = words.turn_rad[row].sum(axis=1)
    area = np.pi * plane.arms[at].sum(axis=1) ** 2
    swapped = config.swapped / max(plane.n - 1, 1)
    chance = np.where(at == row, 1.0 - config.swapped, swapped) / area / config.stray_per_mm2
    weights, lefts = np.zeros((3, len(fit))), np.full((3, len(fit)), np.inf)
    across = turn[:, None] * np.stack([-arm[:, 1], arm[:, 0]], axis=1)  # in a turn of theta
    for elbow in (1.0, -1.0):
        way, can = _ways(plane, at, arm, elbow, turn)
        for how, way_mm in ((0, way), (1, -way), (2, across), (2, -across)):
            log, left = _compared(fits.moved[fit], fits.squares[fit], way_mm, config)
            weights[how] += np.where(can, np.exp(np.clip(log, -_LARGEST, _LARGEST)), 0.0)
            lefts[how] = np.where(can, np.minimum(lefts[how], left), lefts[how])
    weights *= chance
    weights *= np.array([1.0 - 2.0 * config.miswired, config.miswired, config.miswired])[:, None]
    best = np.zeros(len(places)), np.zeros(plane.n)
    np.maximum.at(best[0], light, weights.max(axis=0))
    np.maximum.at(best[1], row, weights.max(axis=0))
    kept = weights > np.maximum(_LEAST, _SMALL * np.maximum(best[0][light], best[1][row]))
    how, of = np.nonzero(kept)
    order = np.lexsort([light[of], row[of]])
    how, of = how[order], of[order]
    moved2 = (fits.moved**2).sum(axis=1)
    rest = np.exp(-moved2 * fits.squares / (2.0 * (1e-3 * config.error_um) ** 2))[fit[of]]
    return _Pairs(row[of], light[of], at[of], _HOWS[how], weights[how, of], rest, lefts[how, of])


def _compared(
    moved: Points, squares: Floats, way: Points, config: WiringConfig
) -> tuple[Floats, Floats]:
    """Logarithm of the evidence of a way over no movement, and chi2 of what it leaves, (p,)."""
    share = (moved * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-18)
    off = moved - np.clip(share, config.least, 1.05)[:, None] * way
    moved2, off2 = (moved**2).sum(axis=1), (off**2).sum(axis=1)
    variance = (1e-3 * config.error_um) ** 2 / np.maximum(squares, 1e-9)
    return (moved2 - off2) / (2.0 * variance), off2 / (variance + _LENGTHS**2 * moved2)


def _ways(
    plane: FocalPlane, at: Ints, arm: Points, elbow: float, turn: Floats
) -> tuple[Points, Bools]:
    """How a fibre moves in a turn of phi, by the place of its tip from an axis [mm], (p, 2)."""
    l1, l2 = plane.arms[at].T
    distance = np.hypot(*arm.T)
    cosine = (distance**2 - l1**2 - l2**2) / (2.0 * l1 * l2)
    phi = elbow * np.arccos(np.clip(cosine, -1.0, 1.0))
    low, high = plane.limits[at, 1].T
    slack = 0.1  # of the range of phi, for arms that were measured badly [rad]
    can = (np.abs(cosine) <= 1.05) & (phi >= low - slack) & (phi <= high + slack)
    theta = np.arctan2(arm[:, 1], arm[:, 0]) - np.arctan2(l2 * np.sin(phi), l1 + l2 * np.cos(phi))
    both = theta + phi
    return (l2 * turn)[:, None] * np.stack([-np.sin(both), np.cos(both)], axis=1), can
