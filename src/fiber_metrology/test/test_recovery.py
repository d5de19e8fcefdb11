# SPDX-License-Identifier: Apache-2.0
"""Robots at unknown places are found by small turns that touch nothing."""

from dataclasses import replace

import numpy as np
import pytest
from metrology_scene import N, Scene

from fiber_core.clearance import gaps, neighbour_pairs
from fiber_metrology import (
    MetrologyError,
    RecoveryConfig,
    combine,
    recover,
    turn_within_margin,
)
from fiber_metrology.camera import CameraConfig


class Lost(Scene):
    """Robots that stand somewhere, and images before and after their test turns."""

    def __init__(self, seed=0):
        super().__init__(seed, CameraConfig())
        self.turned = turn_within_margin(self.plane)

    def images(self, share=1.0, lit=None, still=()):
        """Lights before and after turns of which robots make a share; `still` make none."""
        made, taken = self.turned * share, []
        made[list(still)] = 0.0
        for turn in (0.0, made):
            self.true[:, 0] += turn
            shots = [each.spots for each in self.expose(lit, exposures=9)]
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


def test_a_turn_moves_no_point_by_more_than_half_of_the_gap_that_neighbours_keep():
    lost, config = Lost(), RecoveryConfig(margin_mm=0.4)
    pairs = neighbour_pairs(lost.plane)
    before = gaps(lost.plane, pairs, lost.true)
    turn = np.stack([turn_within_margin(lost.plane, config), np.zeros(N)], axis=1)
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
    near_stop = found.certain & (np.abs(theta) > 2 * np.pi - limit)
    assert (found.turn_known == (found.certain & ~near_stop)).all()


def test_what_cannot_be_recovered_is_refused_or_not_told():
    lost = Lost()
    with pytest.raises(MetrologyError, match="turned"):
        recover(lost.plane, *lost.images(), lost.turned[1:])
    dark = lost.images(lit=np.zeros(N, dtype=bool))
    assert not recover(lost.plane, *dark, lost.turned).certain.any()
    limits = np.array(lost.plane.limits)
    limits[5, 1, 0] = -np.pi
    with pytest.raises(MetrologyError, match="robot 5 has both elbows"):
        turn_within_margin(replace(lost.plane, limits=limits))
