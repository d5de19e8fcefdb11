# SPDX-License-Identifier: Apache-2.0
"""Robots at unknown places are found by small turns that touch nothing."""

from dataclasses import replace

import numpy as np
import pytest
from metrology_scene import N, Scene

from fiber_core.clearance import gaps, neighbour_pairs
from fiber_core.turns_of_theta import BEYOND_RAD
from fiber_metrology import (
    MeasureConfig,
    MetrologyError,
    RecoveryConfig,
    Verdict,
    combine,
    recover,
    turn_within_margin,
)
from fiber_metrology.camera import CameraConfig
from fiber_metrology.node.turn_images import TurnImages


class Lost(Scene):
    """Robots that stand somewhere, and images before and after their test turns."""

    def __init__(self, seed=0):
        super().__init__(seed, CameraConfig())
        self.turned = turn_within_margin(self.plane)

    def images(self, share=1.0, lit=None, still=(), exposures=9):
        """Lights before and after turns of which robots make a share; `still` make none."""
        made, taken = self.turned * np.reshape(share, (-1, 1)), []
        made[list(still)] = 0.0
        for turn in (0.0, made):
            self.true += turn
            shots = [each.spots for each in self.expose(lit, exposures=exposures)]
            taken.append(combine(shots, self.fiducials, self.camera.calibrated))
        return taken

    def check(self, found):
        rows = found.certain
        off = np.hypot(*(found.places - self.tips)[rows].T)
        assert off.max(initial=0.0) < 0.02
        turn = np.abs((found.angles - self.true + np.pi) % (2 * np.pi) - np.pi)[rows]
        assert (turn <= found.interval_rad[rows] + 1e-9).all()
        return rows


@pytest.mark.parametrize("seed", range(6))
def test_lost_robots_are_found_and_none_is_taken_for_another(seed):
    lost = Lost(seed)
    lit = lost.rng.random(N) >= 0.02
    images = lost.images(lost.rng.uniform(0.6, 1.0, N), lit)
    rows = lost.check(recover(lost.plane, *images, lost.turned))
    assert not rows[~lit].any() and rows.sum() > 0.97 * lit.sum()


class Bent(Lost):
    """Robots with both elbows in range, of which half stand with the other one."""

    def __init__(self, seed=0, least_rad=0.0):
        super().__init__(seed)
        tips, limits = self.tips, np.array(self.plane.limits)
        limits[:, 1] = np.deg2rad([-172.0, 172.0])
        self.plane = replace(self.plane, limits=limits)
        self.true[:, 1] = np.clip(self.true[:, 1], least_rad, np.deg2rad(172.0))
        other = self.rng.random(N) < 0.5
        x, y = (tips - self.plane.centers).T
        lead = np.arctan2(y, x) - self.true[:, 0]
        self.true[other, 0] += 2.0 * lead[other]
        self.true[other, 1] *= -1.0
        self.true[:, 0] = (self.true[:, 0] + np.pi) % (2 * np.pi) - np.pi
        self.turned = turn_within_margin(self.plane)


@pytest.mark.parametrize("seed", range(4))
def test_a_small_turn_of_phi_tells_the_elbow(seed):
    lost = Bent(seed)
    assert not lost.turned[:, 0].any() and (lost.turned[:, 1] > 0.0).all()
    lit = lost.rng.random(N) >= 0.02
    bend = np.abs(lost.true[:, 1])
    for way in (-1.0, 2.0):  # to one end of what neighbours allow, and to the other one
        turned = way * lost.turned
        images = lost.images(way * lost.rng.uniform(0.6, 1.0, N), lit)
        found = recover(lost.plane, *images, turned)
        rows = lost.check(found)  # with its elbow, or not at all
        assert not rows[~lit].any() and rows[lit & (bend > np.deg2rad(130.0))].mean() > 0.8
    assert rows[lit & (bend > np.deg2rad(50.0))].mean() > 0.95
    # a nearly stretched arm moves alike with both
    assert not rows[bend < np.deg2rad(5.0)].any() and (found.angles[rows, 1] < 0.0).sum() > N // 5


def test_images_between_turns_of_phi_find_robots_with_their_elbows():
    lost, turns = Bent(5), TurnImages()
    counters, unplaced = np.zeros((N, 2)), np.ones(N, dtype=np.int64)  # they tell nothing
    found = np.zeros(N, dtype=bool)
    for way in (0.0, 1.0, -2.0):
        counters += way * lost.turned
        lost.true += 0.9 * way * lost.turned
        image = lost.measure(lost.expose(exposures=9), counters=counters.copy(),
                             unplaced=unplaced > 0)  # fmt: skip
        image = turns.find(image, counters.copy(), unplaced, "a", MeasureConfig())
        told = (unplaced > 0) & (image.verdict == Verdict.MEASURED)
        off = np.abs((image.angles - lost.true + np.pi) % (2 * np.pi) - np.pi)[told]
        assert (off <= image.interval_rad[told] + 1e-9).all()
        found |= told
        unplaced[told], counters[told] = 0, image.angles[told]
    assert found.mean() > 0.8


def test_a_turn_of_theta_does_not_tell_the_elbow_and_a_memory_does():
    lost = Bent(1)
    lost.turned = lost.turned[:, ::-1]
    images = lost.images(0.9)
    assert not recover(lost.plane, *images, lost.turned).certain.any()
    rested = lost.true + lost.rng.uniform(-0.01, 0.01, (N, 2))
    found = recover(lost.plane, *images, lost.turned, recalled=rested)
    assert lost.check(found).mean() > 0.95 and found.turn_known[found.certain].all()


def test_an_elbow_that_the_range_of_phi_leaves_alone_needs_no_telling():
    lost = Lost(2)
    limits = np.array(lost.plane.limits)
    limits[:, 1] = np.deg2rad([-12.0, 190.0])
    lost.plane = replace(lost.plane, limits=limits)
    lost.turned = turn_within_margin(lost.plane)
    rows = lost.check(recover(lost.plane, *lost.images(0.9), lost.turned))
    alone = (lost.true[:, 1] > np.deg2rad(13.0)) & (lost.true[:, 1] < np.deg2rad(169.0))
    assert rows[alone].mean() > 0.97


def test_a_turn_moves_no_point_by_more_than_half_of_the_gap_that_neighbours_keep():
    lost, config = Lost(), RecoveryConfig(margin_mm=0.4)
    pairs = neighbour_pairs(lost.plane)
    before = gaps(lost.plane, pairs, lost.true)
    turn = turn_within_margin(lost.plane, config)
    assert (turn[:, 0] > 0.0).all() and not turn[:, 1].any()
    for sign in np.random.default_rng(1).choice([-1.0, 1.0], (20, N, 1)):
        after = gaps(lost.plane, pairs, lost.true + sign * turn)
        closer = before - after
        assert 0.1 < closer.max() <= 0.4


def test_a_robot_that_does_not_turn_beside_others_is_not_guessed():
    lost = Lost(3)
    still = np.arange(0, N, 4)
    found = recover(lost.plane, *lost.images(still=still), lost.turned)
    lost.check(found)
    turning = np.setdiff1d(np.arange(N), still)
    assert found.certain[turning].mean() > 0.85


def test_theta_with_another_turn_in_its_range_is_told():
    lost = Lost(1)
    found = recover(lost.plane, *lost.images(0.9), lost.turned)
    theta = found.angles[:, 0]
    limit = lost.plane.limits[:, 0, 1]
    beyond = BEYOND_RAD + found.interval_rad[:, 0]
    near_stop = found.certain & (np.abs(theta) >= 2 * np.pi - limit - beyond)
    assert (found.turn_known == (found.certain & ~near_stop)).all()
    assert 0 < near_stop.sum() < 0.2 * N


def test_an_arm_at_or_beyond_its_stop_is_not_told_with_another_turn():
    lost = Lost(4)
    low, high = lost.plane.limits[0, 0]
    lost.true[:, 0] = np.where(np.arange(N) % 2, low, high)
    lost.true[:, 0] += np.where(np.arange(N) % 2, -1, 1) * lost.rng.uniform(0.0, 0.045, N)
    found = recover(lost.plane, *lost.images(), lost.turned)
    assert found.certain.mean() > 0.5 and not found.turn_known.any()
    # the angle in range is the other one, and would be believed
    assert (np.abs(found.angles - lost.true)[found.certain, 0] > 1.0).all()


def test_what_cannot_be_recovered_is_refused_or_not_told():
    lost = Lost()
    with pytest.raises(MetrologyError, match="turned"):
        recover(lost.plane, *lost.images(), lost.turned[1:])
    dark = lost.images(lit=np.zeros(N, dtype=bool))
    assert not recover(lost.plane, *dark, lost.turned).certain.any()
    twice = np.array(lost.turned)
    twice[5, 1] = 0.001
    with pytest.raises(MetrologyError, match="robot 5 turned both joints"):
        recover(lost.plane, *dark, twice)


@pytest.mark.parametrize("seed", range(4))
def test_two_images_of_three_exposures_find_fibres_that_some_of_these_lack(seed):
    lost = Lost(seed)
    lit = lost.rng.random(N) >= 0.02
    images = lost.images(lost.rng.uniform(0.6, 1.0, N), lit, exposures=3)
    config = RecoveryConfig(error_um=4.5 / np.sqrt(3.0))
    rows = lost.check(recover(lost.plane, *images, lost.turned, config))
    once = sum(int((each.seen == 1).sum()) for each in images)
    assert once > 4 and not rows[~lit].any() and rows.sum() >= 0.98 * lit.sum()


def test_a_robot_without_a_free_light_in_its_reach_is_missing_after_a_turn():
    lost = Lost(2)
    lost.camera.config = replace(lost.camera.config, stray=0.0, missing=0.0, merged=0.0)
    dark = np.arange(N) % 10 == 0
    still = np.flatnonzero(np.arange(N) % 10 == 5)
    turns, told = TurnImages(), []
    counters = lost.counters.copy()
    unplaced = np.ones(N, dtype=np.int64)
    made = lost.turned.copy()
    made[still] = 0.0
    for turn, of_arm in ((0.0, 0.0), (lost.turned, made)):
        counters += turn
        lost.true += of_arm
        image = lost.measure(lost.expose(~dark, exposures=3), counters=counters,
                             unplaced=np.ones(N, dtype=bool))  # fmt: skip
        told.append(turns.find(image, counters.copy(), unplaced, "a", MeasureConfig()))
    assert (told[0].verdict == Verdict.UNPLACED).all()  # one image alone tells nothing
    left = ~told[1].certain
    missing = told[1].verdict == Verdict.MISSING
    assert left[dark].all() and missing[dark].sum() > 0.5 * dark.sum()
    assert not missing[~dark].any()  # a light that is not told may be theirs
    assert (told[1].verdict[left & ~missing] == Verdict.UNPLACED).all()
