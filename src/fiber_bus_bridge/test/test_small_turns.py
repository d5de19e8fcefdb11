# SPDX-License-Identifier: Apache-2.0
"""Test turns, turns to stops and turns by code words of motors with listed speeds."""

from dataclasses import replace

import numpy as np
import pytest
from session_rig import Rig
from unplaced_rig import ALL, CONFIG, HALF_MM, N, place

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.stop_turns import turn_to_stops
from fiber_bus_bridge.unplaced_robots import turn_unplaced
from fiber_bus_bridge.word_turns import turn_words
from fiber_core.clearance import levers_of
from fiber_core.drive import rules_broken
from fiber_core.drive.named import with_drive
from fiber_core.turns_of_theta import PAST_STOP_RAD


class ListedRig(Rig):
    """Robots with the motors of DESI, at unknown places.

    Args:
        listed: other values of their list of speeds.
        seen_rad: theta at which a camera has seen them, without their turn; None for nowhere.
    """

    def __init__(self, seen_rad=None, **listed):
        self._listed = listed
        super().__init__(N, config=CONFIG, volatile=True)
        self.call("configure")
        if seen_rad is not None:
            at = np.stack([np.full(N, seen_rad), np.full(N, 2.6)], axis=1)
            place(self, self.units.encoder_counts(self.plane, at), ALL, turn_known=False)

    def changed(self, plane):
        plane = with_drive(plane, "desi")
        listed = replace(plane.drive.listed, **self._listed)
        return replace(
            plane, drive=plane.drive.__class__(N, listed=listed, scale=plane.drive.scale)
        )

    def made(self):
        """Let the motion that has begun end; return what joints have turned [rad]."""
        motion = self.session.loaded_plan.motion
        assert len(rules_broken(self.plane.drive, motion.decoded())) == 0
        self.run()
        return (motion.end - motion.start) * self.units.quantum_rad


NO_APPROACH = {"approach_rad": np.zeros(2)}


def test_motors_whose_moves_end_with_an_approach_make_no_test_turns():
    rig, before = ListedRig(), None
    before = rig.where()
    with pytest.raises(SessionError, match="each move of theta ends with an approach of 3 deg"):
        turn_unplaced(rig.session, rig.t)
    with pytest.raises(SessionError, match="each move of theta ends with an approach of 3 deg"):
        turn_to_stops(rig.session, np.ones(N), rig.t)
    with pytest.raises(SessionError, match="each move of phi ends with an approach of 3 deg"):
        turn_words(rig.session, np.ones(N), rig.t)
    assert np.array_equal(rig.where(), before)


def test_motors_without_an_approach_turn_within_their_gaps_at_their_slowest_speed():
    rig = ListedRig(**NO_APPROACH)
    for _ in range(3):
        rig.t = turn_unplaced(rig.session, rig.t)
        moved_mm = np.abs(rig.made()[:, 0]) * levers_of(rig.plane)[:, 0]
        assert rig.session.loaded_plan.started.all()
        assert (moved_mm <= HALF_MM + 1e-9).all() and (moved_mm > 0.5 * HALF_MM).all()


def test_motors_without_an_approach_turn_to_their_stops():
    rig = ListedRig(3.0, **NO_APPROACH)
    rig.t = turn_to_stops(rig.session, np.ones(N), rig.t)
    started = rig.session.loaded_plan.started
    turned = rig.made()[started, 0]
    high = rig.plane.limits[started, 0, 1]
    wanted = high - 3.0 + PAST_STOP_RAD
    assert started.any() and (turned <= wanted).all() and (turned > wanted - 0.001).all()
    assert rig.session.robots["lost"][started].all()


def test_motors_without_an_approach_turn_by_code_words():
    rig = ListedRig(**NO_APPROACH)
    place(rig, rig.units.encoder_counts(rig.plane, np.tile([0.0, 2.6], (N, 1))), ALL)
    rig.t = turn_words(rig.session, np.ones(N), rig.t)
    moved_mm = rig.made()[:, 1] * levers_of(rig.plane)[:, 1]
    assert rig.session.loaded_plan.started.all()
    assert (moved_mm <= HALF_MM + 1e-9).all() and (moved_mm > 0.5 * HALF_MM).all()
