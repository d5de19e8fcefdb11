# SPDX-License-Identifier: Apache-2.0
"""Code words tell which order moves which fibre; what is not certain is not told."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.clearance import gaps, levers_of, neighbour_pairs
from fiber_core.fields import random_field
from fiber_core.presets import preset
from fiber_metrology import (
    Lights,
    MetrologyError,
    WiringConfig,
    WiringVerdict,
    code_words,
    tell_wiring,
)

N = 200
NOISE_MM = 4.5e-3


class Plane:
    """Robots of which some are swapped, dark or stuck, and images of their code words."""

    def __init__(self, seed, swaps=8, n=N, noise_mm=NOISE_MM, plane=None):
        self.rng = rng = np.random.default_rng(seed)
        self.plane = plane or preset("desi", n)
        self.arms = np.array(random_field(self.plane, rng).problem.start)
        self.words = code_words(self.plane, rng)
        self.noise_mm = noise_mm
        self.moves = np.arange(n)  # whose arm the orders for each robot move
        pairs = neighbour_pairs(self.plane)
        pairs = rng.permutation(pairs[(pairs < n).all(axis=1)])
        far = rng.permutation(n).reshape(-1, 2)
        for a, b in self._few(pairs, far, swaps):
            self.moves[[a, b]] = b, a
        self.dark = rng.random(n) < 0.02
        self.share = rng.uniform(0.5, 1.0, n)
        self.share[rng.random(n) < 0.01] = 0.0

    @staticmethod
    def _few(pairs, far, swaps):
        """Half of the swaps are of neighbours; no robot is in two of them."""
        used, chosen = set(), []
        for source, most in ((pairs, swaps // 2), (far, swaps)):
            for a, b in source:
                if len(chosen) < most and not {a, b} & used:
                    chosen.append((a, b))
                    used |= {a, b}
        return chosen

    def images(self, missed=0.05, stray=2):
        found = []
        lasting = self.rng.uniform(-60, 60, (stray, 2))
        for turned in self.words.turned_rad.T:
            arms = self.arms.copy()
            arms[self.moves, 1] += turned * self.share
            tips = kinematics.forward(self.plane, arms)[1]
            seen = ~self.dark & (self.rng.random(len(tips)) >= missed)
            here = np.concatenate([tips[seen], lasting])
            here = here + self.rng.normal(0.0, self.noise_mm, here.shape)
            few = np.zeros(len(here), dtype=int)
            found.append(Lights(here, few + 3, few > 0, 3, [], np.zeros((len(here), 2), dtype=int)))
        return found

    @property
    def tellable(self):
        """Robots whose orders move a fibre that is lit."""
        lit = ~self.dark[self.moves]
        return lit & (self.share > 0.0)


def check(robots, told):
    rows = np.flatnonzero(told.at >= 0)
    assert np.array_equal(told.at[rows], robots.moves[rows])
    assert robots.tellable[rows].all()
    tips = kinematics.forward(robots.plane, robots.arms)[1][told.at[rows]]
    assert np.hypot(*(told.places[rows] - tips).T).max() < 0.01
    swapped = told.verdict == WiringVerdict.SWAPPED
    assert np.array_equal(swapped[rows], (robots.moves != np.arange(robots.plane.n))[rows])
    assert (told.verdict[~robots.tellable] >= WiringVerdict.NOT_SEEN).all()
    return len(rows)


@pytest.mark.parametrize("block", range(4))
def test_swapped_robots_are_told_and_none_wrongly(block):
    told, tellable, swapped = 0, 0, 0
    for seed in range(10 * block, 10 * block + 10):
        robots = Plane(seed)
        found = tell_wiring(robots.plane, robots.words, robots.images())
        told += check(robots, found)
        tellable += robots.tellable.sum()
        swapped += (found.verdict == WiringVerdict.SWAPPED).sum()
    assert told >= 0.99 * tellable and swapped > 0.9 * 10 * 16


def test_with_a_bad_camera_less_is_told_and_nothing_wrongly():
    told = []
    for seed in range(6):
        robots = Plane(seed, noise_mm=3 * NOISE_MM)
        config = WiringConfig(error_um=3e3 * NOISE_MM)
        told.append(check(robots, tell_wiring(robots.plane, robots.words, robots.images(), config)))
    assert 0 < np.mean(told) < 0.99 * N


def test_turns_of_words_move_no_point_by_more_than_half_of_the_margin():
    robots = Plane(1)
    lever = levers_of(robots.plane)[:, 1]
    assert np.allclose(robots.words.turn_rad * lever, 0.025)
    pairs = neighbour_pairs(robots.plane)
    before = gaps(robots.plane, pairs, robots.arms)
    for turned in robots.words.turned_rad.T[:4]:
        arms = robots.arms.copy()
        arms[:, 1] += turned
        assert (gaps(robots.plane, pairs, arms) > before - 0.05).all()


def test_any_two_words_differ_in_a_quarter_of_the_images():
    words = code_words(preset("desi", 5000), np.random.default_rng(2)).bits.astype(np.int64)
    both = words[:500] @ words.T
    apart = words[:500].sum(axis=1)[:, None] + words.sum(axis=1) - 2 * both
    assert np.array_equal(np.sort(apart, axis=1)[:, 0], np.zeros(500))
    assert np.sort(apart, axis=1)[:, 1].min() >= 8
    with pytest.raises(MetrologyError, match="5000 robots have no words of their own"):
        code_words(preset("desi", 5000), np.random.default_rng(2), images=16)
    with pytest.raises(MetrologyError, match="20 images: code words have 16 or 32 bits"):
        code_words(preset("desi", 50), np.random.default_rng(2), images=20)


def test_robots_with_both_elbows_are_told_too():
    plane = preset("desi", N)
    limits = np.array(plane.limits)
    limits[:, 1] = -np.pi, np.pi
    robots = Plane(3, plane=replace(plane, limits=limits))
    told = check(robots, tell_wiring(robots.plane, robots.words, robots.images()))
    assert told > 0.9 * robots.tellable.sum()


def test_lines_name_pairs_and_robots_that_move_no_light():
    robots = Plane(5)
    found = tell_wiring(robots.plane, robots.words, robots.images())
    lines = found.lines(robots.plane)
    assert len(lines) == (found.verdict != WiringVerdict.IN_PLACE).sum()
    a = int(np.flatnonzero(found.verdict == WiringVerdict.SWAPPED)[0])
    ids, b = robots.plane.ids, int(found.at[a])
    assert any(
        line.startswith(f"robot {ids[a]}: orders move the fibre at the place of robot {ids[b]}")
        for line in lines
    )
    dark = np.flatnonzero(~robots.tellable)[0]
    assert any(line.startswith(f"robot {ids[dark]}: ") for line in lines)


def test_images_without_light_tell_nothing_and_other_words_are_refused():
    robots = Plane(6)
    empty = Lights(
        np.zeros((0, 2)), np.zeros(0, int), np.zeros(0, bool), 3, [], np.zeros((0, 2), int)
    )
    found = tell_wiring(robots.plane, robots.words, [empty] * 32)
    assert (found.verdict == WiringVerdict.NOT_SEEN).all() and (found.at == -1).all()
    with pytest.raises(MetrologyError, match="words of 200 robots and 32 images, for 200 robots"):
        tell_wiring(robots.plane, robots.words, [empty] * 31)
