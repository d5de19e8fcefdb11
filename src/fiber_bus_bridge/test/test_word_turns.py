# SPDX-License-Identifier: Apache-2.0
"""Turns of phi by code words: certified from where robots rest, wherever other words led them."""

import numpy as np
import pytest
from session_rig import Rig
from unplaced_rig import new_rig

from fiber_bus_bridge import SessionState
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.measured_places import place_robots
from fiber_bus_bridge.node.outlines import BlindErrors, Outlines
from fiber_bus_bridge.protocol.decisions import neighbours_of
from fiber_bus_bridge.protocol.turn_limits import half_gaps
from fiber_bus_bridge.word_turns import cannot_turn, turn_words
from fiber_core.clearance import Safety, gaps, levers_of, neighbour_pairs

HALF_MM = 0.5 * Safety().margin_mm


def found_rig(**options):
    rig = Rig(**options)
    rig.call("configure")
    return rig


def turn(rig, way):
    rig.t = turn_words(rig.session, np.broadcast_to(way, rig.plane.n), rig.t)
    rig.run()


def moved_mm(rig, before):
    return (np.abs(rig.where() - before) * rig.units.quantum_rad * levers_of(rig.plane)).sum(1)


def test_words_lead_from_one_side_to_the_other_and_never_beyond_half_of_the_margin():
    rig = found_rig()
    before, rng = rig.where(), np.random.default_rng(5)
    for _ in range(4):
        way = rng.choice([-1, 1], rig.plane.n)
        turn(rig, way)
        off = rig.where() - before
        assert (off[:, 0] == 0).all() and np.array_equal(np.sign(off[:, 1]), way)
        far = moved_mm(rig, before)
        assert (far > 0.95 * HALF_MM).all() and (far <= HALF_MM).all()
    turn(rig, 0)
    assert (moved_mm(rig, before) < 0.02 * HALF_MM).all()
    assert rig.session.state is SessionState.IDLE and not rig.session.robots["lost"].any()


def test_a_turn_after_any_other_motion_begins_where_the_robots_rest_then():
    rig = found_rig()
    turn(rig, 1)
    rig.session.submit(rig.orders(0, -400))
    rig.call("start")
    rig.run()
    before = rig.where()
    turn(rig, 1)
    assert (moved_mm(rig, before) > 0.95 * HALF_MM).all()
    # and an image may tell that the robots are elsewhere
    counts = rig.where() - [0, 40]
    place_robots(rig.session, counts, np.ones(rig.plane.n, dtype=bool), rig.t)
    turn(rig, 1)
    assert (moved_mm(rig, counts) > 0.95 * HALF_MM).all()


def test_robots_closer_than_the_margin_rest_or_turn_by_half_of_their_gap():
    rig = found_rig()
    plane, n = rig.plane, rig.plane.n
    angles = rig.session.angles
    pairs = neighbour_pairs(plane)
    pairs = pairs[(pairs < n).all(axis=1)]
    gap_mm = gaps(plane, pairs, angles)
    least = int(np.argmin(gap_mm))
    # outlines that are wider by what is not known of the arms: 0.6 of the margin is left there
    wider = 0.5 * (gap_mm[least] - 0.6 * Safety().margin_mm)
    rig.session.protocol.known_mm = np.full((n, 2), wider)
    assert not cannot_turn(rig.session).any()
    before = rig.where()
    turn(rig, 1)
    far = moved_mm(rig, before)
    assert (far[pairs[least]] <= 0.6 * HALF_MM).all() and (far[pairs[least]] > 0.5 * HALF_MM).all()
    turn(rig, 0)
    rig.session.protocol.known_mm += 0.2 * Safety().margin_mm
    rig.session.protocol.words = None
    assert set(pairs[least]) <= set(np.flatnonzero(cannot_turn(rig.session)))
    with pytest.raises(SessionError, match=r"gaps allow no turn .* robot \d+ may move by 0.0"):
        turn_words(rig.session, np.where(cannot_turn(rig.session), 1.0, np.nan), rig.t)


class Silent:
    def publish_layout(self, always=False):
        pass


def test_turns_after_an_image_count_from_gaps_that_hold_the_errors_of_moves():
    rig = found_rig()
    plane, session = rig.plane, rig.session
    pairs = neighbour_pairs(plane)
    pairs = pairs[(pairs < plane.n).all(axis=1)]
    gap_mm = gaps(plane, pairs, session.angles)
    least = int(np.argmin(gap_mm))
    error_um = 1e3 * (gap_mm[least] / 2.0 - 0.3 * Safety().margin_mm)
    outlines = Outlines(session, plane, BlindErrors(error_um, 1.0), Silent())
    blind = half_gaps(session.protocol)
    assert (blind < HALF_MM).any()
    # an image tells where arms rest, and nothing of the turns that follow
    outlines.learn(np.zeros((2, plane.n)).T)
    assert np.array_equal(half_gaps(session.protocol), blind)


def test_robots_at_unknown_places_and_their_neighbours_rest():
    rig = new_rig()
    robots = rig.session.robots
    for column in ("unplaced", "recalled", "lost"):
        robots[column] = False
    robots["placed"] = True
    robots["unplaced"][3] = robots["lost"][3] = True
    lost = np.arange(rig.plane.n) == 3
    blocked = lost | neighbours_of(lost, rig.session.protocol.pairs)
    before = rig.where()
    turn(rig, 1)
    assert np.array_equal(moved_mm(rig, before) == 0.0, blocked)


def test_a_loss_of_power_between_two_words_leaves_no_test_turn_that_could_touch():
    rig = new_rig()
    robots = rig.session.robots
    for column in ("unplaced", "recalled", "lost"):
        robots[column] = False
    robots["placed"] = True
    limits = []

    def look():
        limits.append(rig.session.memory(np.zeros(rig.plane.n, int), starting=True).turn_limit)
        return True

    rig.t = turn_words(rig.session, np.ones(rig.plane.n), rig.t, look)
    # on disk before the GO: while words are made, the turns of theta are used up
    assert (limits[0] == 0).all()
    rig.run()
    # at rest the counters tell the gaps again: words have brought no two of these robots near
    assert (robots["turn_limit"] > 0).all()


def test_an_arm_at_the_end_of_its_range_turns_one_way_alone():
    n = 19
    rig = found_rig(start=np.stack([np.linspace(-1, 1, n), np.full(n, np.pi - 5e-6)], axis=1))
    before = rig.where()
    turn(rig, 1)
    assert (moved_mm(rig, before) < 0.001 * HALF_MM).all()
    turn(rig, -1)
    assert (moved_mm(rig, before) > 0.95 * HALF_MM).all()
