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
    assert np.allclose(robots.words.turn_rad * lever[:, None], 0.025)
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


def tip_images(robots, turned_of):
    """Images of robots of which the turns of theta and phi are told by turned_of(row of image)."""
    found = []
    for turned in robots.words.turned_rad.T:
        tips = kinematics.forward(robots.plane, robots.arms + turned_of(turned))[1]
        here = tips[~robots.dark & (robots.rng.random(len(tips)) >= 0.05)]
        here = here + robots.rng.normal(0.0, robots.noise_mm, here.shape)
        few = np.zeros(len(here), dtype=int)
        found.append(Lights(here, few + 3, few > 0, 3, [], np.zeros((len(here), 2), dtype=int)))
    return found


def miswired(robots, reversed_=(), crossed=()):
    """What the arms of robots turn by: some the other way, and some theta in place of phi."""

    def turned_of(turned):
        turns = np.zeros((len(turned), 2))
        turns[robots.moves, 1] = turned * robots.share
        turns[robots.moves[list(reversed_)], 1] *= -1.0
        arms = robots.moves[list(crossed)]
        turns[arms] = turns[arms][:, ::-1]
        return turns

    return tip_images(robots, turned_of)


@pytest.mark.parametrize("block", range(4))
def test_reversed_and_crossed_motors_are_told_as_such_or_not_at_all(block):
    told, bad = 0, 0
    for seed in range(10 * block, 10 * block + 10):
        robots = Plane(seed, swaps=4, n=92)
        # with more of a turn lost, a straight arm that turns theta looks as one that turns phi
        robots.share = np.where(robots.share > 0.0, np.maximum(robots.share, 0.6), 0.0)
        sound = robots.rng.permutation(np.flatnonzero(robots.moves == np.arange(92)))
        swapped = np.flatnonzero(robots.moves != np.arange(92))[:2]
        other_way, theta = [*sound[:8], *swapped], sound[8:16]
        images = miswired(robots, other_way, theta)
        found = tell_wiring(robots.plane, robots.words, images)
        rows = np.flatnonzero(found.at >= 0)
        assert np.array_equal(found.at[rows], robots.moves[rows]), seed
        truth = np.where(robots.moves == np.arange(92), 0, int(WiringVerdict.SWAPPED))
        truth[other_way], truth[theta] = WiringVerdict.REVERSED, WiringVerdict.OTHER_JOINT
        assert np.array_equal(found.verdict[rows], truth[rows]), seed
        lines = found.lines(robots.plane)
        for verdict, text in ((4, "orders turn phi the other way"), (5, "of phi turn theta")):
            assert sum(text in line for line in lines) == (found.verdict == verdict).sum()
        told += np.isin(found.verdict, (4, 5)).sum()
        bad += len(other_way) + len(theta)
    assert told > 0.75 * bad


def test_two_robots_at_one_address_are_ambiguous_and_told():
    named, doubles = 0, 0
    for seed in range(30):
        robots = Plane(seed, swaps=0, n=92)
        pairs = neighbour_pairs(robots.plane)
        a, b = robots.rng.permutation(pairs[(pairs < 92).all(axis=1)])[0]
        robots.share[[a, b]] = 0.8, 0.9
        robots.dark[[a, b]] = False

        def turned_of(turned, robots=robots, a=a, b=b):
            heard = np.array(turned)
            heard[b] = turned[a]
            return np.stack([np.zeros(92), heard * robots.share], axis=1)

        found = tell_wiring(robots.plane, robots.words, tip_images(robots, turned_of))
        assert found.verdict[a] == WiringVerdict.AMBIGUOUS and found.at[a] == -1, seed
        assert found.at[b] == -1 and found.lights[a] == 2
        rows = np.flatnonzero(found.at >= 0)
        assert np.array_equal(found.at[rows], rows), seed
        start = f"robot {robots.plane.ids[a]}: ambiguous, 2 lights move by its orders"
        named += start in found.lines(robots.plane)
        doubles += 1
    assert named == doubles


def test_a_movement_that_no_wiring_explains_is_ambiguous():
    told = 0
    for seed in range(20):
        robots = Plane(seed, swaps=0, n=92)
        odd = robots.rng.permutation(np.flatnonzero(robots.tellable))[:10]
        # such an arm turns theta and phi in a ratio of its own
        ratio = robots.rng.uniform(-1.0, 1.0, (10, 2))

        def turned_of(turned, robots=robots, odd=odd, ratio=ratio):
            turns = np.stack([np.zeros(92), turned * robots.share], axis=1)
            turns[odd] = turned[odd, None] * ratio
            return turns

        found = tell_wiring(robots.plane, robots.words, tip_images(robots, turned_of))
        rows = np.flatnonzero(found.at >= 0)
        wrong = rows[found.at[rows] != rows]
        assert not len(wrong), (seed, wrong)
        told += (found.at[odd] >= 0).sum()
    assert told < 0.5 * 200  # the rest looks as phi or theta alone does


def test_turns_stay_within_the_range_of_phi_and_what_test_turns_have_left():
    plane, rng = preset("desi", 91), np.random.default_rng(4)
    low, high = plane.limits[:, 1].T
    phi = np.array(high)  # where HOME leaves robots
    phi[:30], phi[30:60], phi[60] = low[:30], rng.uniform(low, high)[30:60], np.nan
    words = code_words(plane, rng, phi_rad=phi)
    at = phi[:, None] + words.turned_rad
    fits = np.isfinite(phi)
    assert (at <= high[:, None] + 1e-12)[fits].all() and (at >= low[:, None] - 1e-12)[fits].all()
    full = 0.025 / levers_of(plane)[:, 1]
    assert np.allclose(words.turn_rad.max(axis=1), full)
    assert np.allclose(words.turn_rad[60:61], full[60]) and (words.turn_rad[61:, 1] == 0.0).all()
    limit = np.full((91, 2), 1.0)
    limit[3], limit[5] = (0.0, 1.0), (0.02 / levers_of(plane)[5, 0], 1.0)
    left = code_words(plane, rng, turn_limit_rad=limit).turn_rad * levers_of(plane)[:, 1:2]
    assert np.allclose(left[3], 0.0) and np.allclose(left[5], 0.02) and np.allclose(left[6:], 0.025)
    limit[7, 1] = -0.1
    with pytest.raises(MetrologyError, match=f"robot {plane.ids[7]}: turn_limit_rad .* 0 or more"):
        code_words(plane, rng, turn_limit_rad=limit)
    with pytest.raises(MetrologyError, match=r"phi_rad has shape \(3,\), for 91 robots it is"):
        code_words(plane, rng, phi_rad=phi[:3])


def test_robots_at_an_end_of_phi_are_told_and_those_without_a_turn_are_not():
    for seed in range(8):
        robots = Plane(seed, n=92)
        low, high = robots.plane.limits[:, 1].T
        ends = robots.rng.permutation(92)[:40]
        robots.arms[ends, 1] = np.where(robots.rng.random(40) < 0.5, low[ends], high[ends])
        limit = np.ones((92, 2))
        still = robots.rng.permutation(92)[:5]
        limit[still] = 0.0
        robots.words = code_words(
            robots.plane, robots.rng, phi_rad=robots.arms[:, 1], turn_limit_rad=limit
        )
        robots.share[still] = 0.0
        found = tell_wiring(robots.plane, robots.words, robots.images())
        rows = np.flatnonzero(found.at >= 0)
        assert np.array_equal(found.at[rows], robots.moves[rows])
        assert (found.at[still] == -1).all()
        assert len(rows) > 0.7 * robots.tellable.sum()


def test_a_robot_that_did_not_turn_is_told_as_that_and_not_as_dark():
    robots = Plane(4, swaps=0)
    rested = np.arange(N) % 5 == 0
    words = robots.words
    robots.words = replace(words, turn_rad=np.where(rested[:, None], 0.0, words.turn_rad))
    told = tell_wiring(robots.plane, robots.words, robots.images())
    assert np.array_equal(told.verdict == WiringVerdict.NOT_TURNED, rested)
    check(robots, told)
    assert (told.at[rested] < 0).all() and (told.doubt[rested] == 1.0).all()
    lines = told.lines(robots.plane)
    assert sum("did not turn, nothing is told" in line for line in lines) == rested.sum()
    assert len(told.columns(robots.plane)["verdict"]) == N == sum(told.counts().values())


def test_a_dark_fibre_and_a_stuck_joint_are_told_apart_by_the_light_that_rests():
    robots = Plane(6, swaps=0)
    robots.share[:] = np.maximum(robots.share, 0.5)
    robots.dark[:] = False
    centers = robots.plane.centers
    far = np.hypot(*(centers - centers[0]).T)
    dark, stuck = 0, int(np.argmax(far))
    robots.dark[dark], robots.share[stuck] = True, 0.0
    told = tell_wiring(robots.plane, robots.words, robots.images(stray=0))
    check(robots, told)
    assert told.verdict[[dark, stuck]].tolist() == [WiringVerdict.NOT_SEEN] * 2
    assert told.resting[[dark, stuck]].tolist() == [False, True]
    lines = {line.partition(":")[0]: line for line in told.lines(robots.plane)}
    assert lines[f"robot {robots.plane.ids[dark]}"].endswith("none rests in its reach")
    assert lines[f"robot {robots.plane.ids[stuck]}"].endswith("one rests in its reach")
