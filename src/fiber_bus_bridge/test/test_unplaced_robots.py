# SPDX-License-Identifier: Apache-2.0
"""Robots whose counters tell nothing: they rest, with their neighbours, and turn a little."""

import numpy as np
import pytest
from session_rig import Rig

from fiber_bus_bridge import SessionConfig
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.home import hold_beyond, turn_motion
from fiber_bus_bridge.measured_places import place_robots
from fiber_bus_bridge.protocol.decisions import neighbours_of
from fiber_bus_bridge.unplaced_robots import turn_unplaced
from fiber_core.clearance import Safety, levers_of
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion

ROWS = np.array([0, 7])
CONFIG = SessionConfig(counters_kept=False)


def with_lost_power(**options):
    rig = Rig(volatile=True, **options)
    rig.call("configure")
    # these rigs begin without a memory: all robots are where they were assumed
    for column in ("unplaced", "recalled", "lost"):
        rig.session.robots[column] = False
    rig.robots.power(ROWS, False, rig.t)
    rig.robots.power(ROWS, True, rig.t)
    rig.t += 0.1
    rig.call("configure")
    return rig


def test_counters_that_power_loss_deletes_are_not_believed():
    rig = with_lost_power(config=CONFIG)
    unplaced = np.isin(np.arange(rig.plane.n), ROWS)
    assert np.array_equal(rig.session.robots["unplaced"], unplaced)
    assert np.array_equal(rig.session.usable, ~unplaced)
    # the encoders read where the robots rested: that tells the turn of theta
    assert rig.session.counts[ROWS].any(axis=1).all()
    assert np.array_equal(rig.where(), rig.session.counts)
    rig.session.submit(rig.orders(400, 0))
    rig.call("start")
    blocked = unplaced | neighbours_of(unplaced, rig.session.protocol.pairs)
    assert np.array_equal(rig.session.loaded_plan.reason == Reason.PLACE_UNKNOWN, blocked)
    assert blocked.sum() > len(ROWS) and not blocked.all()


def test_counters_that_outlive_power_are_believed():
    rig = Rig()
    rig.call("configure")
    rig.robots.power(ROWS, False, rig.t)
    rig.robots.power(ROWS, True, rig.t)
    rig.t += 0.1
    rig.call("configure")
    assert rig.session.usable.all() and not rig.session.robots["lost"].any()


def test_robots_at_unknown_places_turn_by_half_the_margin_and_no_other_moves():
    rig = with_lost_power(config=CONFIG)
    before = rig.where()
    rig.t = turn_unplaced(rig.session, rig.t)
    rig.run()
    moved_rad = np.abs(rig.where() - before) * rig.units.quantum_rad
    moved_mm = (moved_rad * levers_of(rig.plane)).sum(axis=1)
    others = ~np.isin(np.arange(rig.plane.n), ROWS)
    assert (moved_mm[others] == 0.0).all() and (moved_rad[:, 1] == 0.0).all()
    half_mm = 0.5 * Safety().margin_mm
    assert (moved_mm[ROWS] > 0.98 * half_mm).all() and (moved_mm[ROWS] <= half_mm).all()
    # a camera tells where they are: they are in use again
    counts = rig.where()
    place_robots(rig.session, counts, np.ones(rig.plane.n, dtype=bool), rig.t)
    assert rig.session.usable.all() and not rig.session.robots["lost"].any()
    with pytest.raises(SessionError, match="no robot that can be commanded is at an unknown"):
        turn_unplaced(rig.session, rig.t)


def test_a_robot_that_was_seen_rests_until_its_turn_is_vouched_for():
    rig = with_lost_power(config=CONFIG)
    known = np.ones(rig.plane.n, dtype=bool)
    for _ in range(2):  # an image alone tells no turn, however often
        place_robots(rig.session, rig.where(), known, rig.t, turn_known=~known)
        place_robots(rig.session, rig.where(), known, rig.t)
    assert not rig.session.usable[ROWS].any() and not rig.session.robots["lost"].any()
    rig.session.vouch(rig.plane.ids[ROWS])
    assert rig.session.usable.all()


def test_a_longer_turn_of_a_robot_at_an_unknown_place_is_held():
    rig = Rig()
    plane, units = rig.plane, rig.units
    start = units.encoder_counts(plane, np.stack([np.zeros(plane.n), np.full(plane.n, 2.6)], 1))
    half_mm = 0.025
    turn = np.floor(half_mm / levers_of(plane)[:, 0] / units.quantum_rad).astype(np.int64)
    turn[3] *= 2
    motion = turn_motion(units, start, turn, np.full(plane.n, 5), np.ones(plane.n, dtype=bool))
    assert isinstance(motion, WireMotion) and motion.moves.all()
    _, held, certificate = hold_beyond(plane, motion.decoded(), Safety(), half_mm)
    assert np.array_equal(np.flatnonzero(held), [3]) and certificate.ok


def test_a_restart_finds_the_same_robots_at_unknown_places():
    rig = with_lost_power(config=CONFIG)
    memory = rig.session.memory(np.zeros(rig.plane.n, dtype=np.int64))
    later = Rig(volatile=True, config=CONFIG)
    later.robots.memory["boot"] = rig.robots.memory["boot"]
    later.session.recall(memory)
    later.call("configure")
    unplaced = later.session.robots["unplaced"]
    assert np.array_equal(np.flatnonzero(unplaced), ROWS)
    assert later.session.robots["recalled"][ROWS].all()
