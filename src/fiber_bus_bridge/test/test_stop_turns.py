# SPDX-License-Identifier: Apache-2.0
"""Turns to stops tell the turn of theta, and no true arms touch whichever turn is true."""

import numpy as np
import pytest
from unplaced_rig import ALL, N, cut_power, new_rig, place, remembered

from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.simulation import (
    MechanicalErrors,
    arms_at,
    arms_motion,
    draw_mechanics,
    true_angles,
)
from fiber_bus_bridge.stop_turns import blocked_text, stop_turns, turn_to_stops
from fiber_bus_bridge.unplaced_robots import turn_unplaced
from fiber_core.clearance import Safety, certify_arms, gaps, neighbour_pairs
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset
from fiber_core.turns_of_theta import BEYOND_RAD, turns_in_range

PLANE = preset("desi", N)
RANGE = PLANE.limits[:, 0]
LOW, HIGH = RANGE[0]
TURN = 2.0 * np.pi
NONE = np.zeros((0, 2), dtype=np.int64)
_EXACT = Safety(*np.zeros(6))


@pytest.mark.parametrize("beyond_rad", [0.0, 0.02, 0.999 * BEYOND_RAD])
@pytest.mark.parametrize("at", [0.0, 0.001, 7.0, 14.0, 21.0, 27.999, 28.0])
def test_one_of_two_turns_ends_where_one_angle_alone_is_in_range(at, beyond_rad):
    stops = np.array([LOW - beyond_rad, HIGH + beyond_rad])
    for true in LOW + np.deg2rad(at) + np.array([0.0, TURN]):
        ended = []
        for way in (-1, 1):
            told = np.full(N, true)
            start, turn = stop_turns(RANGE, told, np.full(N, way), ALL, NONE)
            # the order is within the ranges, and it is of an arm that stands there
            assert (RANGE[:, 0] <= start).all() and (start + turn <= HIGH + 1e-12).all()
            assert (start + turn >= LOW - 1e-12).all()
            assert np.allclose((start - told) / TURN, np.rint((start - told) / TURN), atol=1e-12)
            end = np.clip(told + turn, *stops)
            lowest, highest = turns_in_range(RANGE, end)
            known = highest == lowest
            assert known.all() or not known.any()
            if known.all():  # then it is the true one
                assert np.array_equal(lowest, end)
            ended.append(known.all())
        assert ended == ([False, True] if true < 0.0 else [True, False])


def test_no_two_neighbours_turn_at_once_and_each_robot_has_its_time():
    pairs = neighbour_pairs(PLANE)
    theta, left, rounds = np.full(N, HIGH - 0.1), ALL.copy(), 0
    while left.any():
        _, turn = stop_turns(RANGE, theta, np.ones(N), left, pairs)
        turns = turn != 0.0
        both = pairs[(pairs < N).all(axis=1)]
        assert not turns[both].all(axis=1).any() and turns.any()
        left &= ~turns
        rounds += 1
    assert rounds <= 4  # a hexagonal plane has three colours


def test_a_robot_whose_turn_is_known_rests():
    theta = np.linspace(LOW, HIGH, N)
    _, turn = stop_turns(RANGE, theta, np.full(N, -1), ALL, NONE)
    lowest, highest = turns_in_range(RANGE, theta)
    assert np.array_equal(turn != 0.0, highest > lowest) and 0 < (turn != 0.0).sum() < N


class Seen:
    """A session with robots that a camera has seen, many without their turn, and their true arms.

    Args:
        seed: of where they stand, which turn is true, and the errors of their arms.
        angles: where the true arms stand [rad], shape (n, 2); by default drawn.
    """

    def __init__(self, seed, angles=None, **errors):
        rng = np.random.default_rng(seed)
        self.rig = rig = new_rig()
        self.mechanics = draw_mechanics(N, MechanicalErrors(**errors), rng, rig.plane.limits)
        drawn = angles is None
        angles = _stand(rig.plane, rng) if drawn else angles
        lowest, highest = turns_in_range(RANGE, angles[:, 0])
        self.unknown = lowest < highest
        if drawn:
            angles[:, 0] = np.where(rng.random(N) < 0.5, lowest, highest)
        self.arms = arms_at(self.mechanics, angles)
        self.least_mm = np.inf
        place(rig, *self.told())

    @property
    def true(self):
        return true_angles(self.mechanics, self.arms)

    def told(self, rows=ALL):
        """What a camera without an error tells: counts, of which robots, and of which the turn."""
        lowest, highest = turns_in_range(RANGE, self.true[:, 0])
        # the angle in range, and of two in range the one nearer to the middle
        theta = np.where(np.abs(lowest) < np.abs(highest), lowest, highest)
        angles = np.stack([theta, self.true[:, 1]], axis=1)
        return self.rig.units.encoder_counts(self.rig.plane, angles), rows, lowest == highest

    def turn(self, way, may_go=lambda: True):
        """Turn robots to their stops, let their arms follow; return which have turned."""
        rig = self.rig
        rig.t = turn_to_stops(rig.session, way, rig.t, may_go)
        rig.run()
        loaded = rig.session.loaded_plan
        motion, self.arms = arms_motion(self.mechanics, self.arms, loaded.motion.decoded())
        certificate = certify_arms(rig.plane, motion, _EXACT, neighbour_pairs(rig.plane))
        assert not certificate.unsafe.any()
        return loaded.started


def _stand(plane, rng):
    """Angles at which no two arms are nearer than the margin, half of them with two turns."""
    pairs, angles = neighbour_pairs(plane), np.tile([0.0, np.pi], (plane.n, 1))
    for row in range(plane.n):
        own = pairs[(pairs == row).any(axis=1)]
        while True:
            wide = rng.random() < 0.5
            angles[row, 0] = rng.uniform(HIGH - TURN, TURN + LOW)
            if wide:
                angles[row, 0] = np.pi + rng.uniform(-1.0, 1.0) * (HIGH - np.pi)
            angles[row, 1] = rng.uniform(0.3, 2.6)
            if gaps(plane, own, angles).min() > 0.1:
                break
    return angles


@pytest.mark.parametrize("seed", range(4))
def test_turns_to_stops_tell_all_turns_and_no_true_arms_touch(seed):
    seen = Seen(seed, scale=0.004, backlash_deg=0.08, wave_deg=0.12)
    rig, robots = seen.rig, seen.rig.session.robots
    assert np.array_equal(robots["seen"], seen.unknown) and seen.unknown.sum() > N // 4
    blocked = np.zeros((N, 2), dtype=bool)
    for _ in range(8):
        for column, way in enumerate((-1.0, 1.0)):
            asked = robots["seen"] & ~blocked[:, column]
            if not asked.any():
                continue
            turned = seen.turn(np.where(asked, way, np.nan))
            assert robots["lost"][turned].all() and not robots["seen"][turned].any()
            held = rig.session.loaded_plan.reason == Reason.UNSAFE_AS_LOADED
            blocked[:, column] |= held | turned
            place(rig, *seen.told())
    # where a neighbour is in the way of one of two turns a robot may stay unknown
    known = ~robots["unplaced"]
    assert (known | blocked.all(axis=1)).all() and known[seen.unknown].mean() > 0.5
    off = np.abs(rig.session.angles - seen.true)
    assert off[known].max() < np.deg2rad(1.1)  # beyond the range, which counters are not


def test_a_robot_at_its_stop_turns_away_from_it_and_comes_into_use():
    folded = np.stack([np.full(N, LOW + 0.01), np.full(N, 3.0)], axis=1)
    seen = Seen(0, folded)
    robots, row = seen.rig.session.robots, 7
    only = np.where(np.arange(N) == row, 1.0, np.nan)
    for way, at, known in ((-1.0, LOW - np.deg2rad(1.0), False), (1.0, 0.0, True)):
        assert np.array_equal(np.flatnonzero(seen.turn(way * only)), [row])
        place(seen.rig, *seen.told())
        assert robots["unplaced"][row] != known
        if not known:  # it stands beyond its range, and its counter reads the other turn
            assert np.isclose(seen.true[row, 0], at)
            assert np.isclose(seen.rig.session.angles[row, 0], at + TURN, atol=1e-6)
    assert abs(seen.true[row, 0] - seen.rig.session.angles[row, 0]) < 1e-6


@pytest.fixture
def seen():
    return Seen(1)


def ways(seen, way=-1.0):
    return np.where(seen.unknown, way, np.nan)


def test_the_file_tells_before_the_go_that_their_places_are_unknown(seen, tmp_path):
    kept, rig = [], seen.rig

    def may_go():
        kept.append(remembered(rig, tmp_path / "robots.json", starting=True))
        return True

    turned = seen.turn(ways(seen), may_go)
    kept.append(remembered(rig, tmp_path / "robots.json"))
    for memory in kept:
        assert memory.lost[turned].all() and memory.unplaced[turned].all()
        assert not memory.placed[turned].any()
    later = new_rig(rig, kept[-1])
    assert later.session.robots["lost"][turned].all()
    with pytest.raises(SessionError, match="cannot be vouched for"):
        rig.session.vouch(rig.plane.ids[turned])


def test_a_turn_that_is_not_started_leaves_the_robots_where_they_were_seen(seen):
    rig, before = seen.rig, seen.rig.session.robots["seen"].copy()
    rig.t = turn_to_stops(rig.session, ways(seen), rig.t, lambda: False)
    rig.run()
    assert np.array_equal(rig.session.robots["seen"], before)
    assert not rig.session.robots["lost"].any()
    assert seen.turn(ways(seen)).any()


def test_test_turns_after_it_touch_nothing_and_find_every_robot(seen):
    rig = seen.rig
    turned = seen.turn(ways(seen))
    beside = turned.copy()
    pairs = neighbour_pairs(rig.plane)
    pairs = pairs[(pairs < N).all(axis=1)]
    beside[pairs[turned[pairs].any(axis=1)]] = True
    rig.session.submit(rig.orders(0, -400))
    rig.call("start")
    started = rig.session.loaded_plan.started
    assert not started[beside].any() and np.array_equal(started, ~beside & ~seen.unknown)
    rig.run()
    rig.t = turn_unplaced(rig.session, rig.t)
    rig.run()
    motion = rig.session.loaded_plan.motion.decoded()
    assert np.array_equal(motion.counts.any(axis=1), turned)
    arms, seen.arms = arms_motion(seen.mechanics, seen.arms, motion)
    assert not certify_arms(rig.plane, arms, _EXACT, neighbour_pairs(rig.plane)).unsafe.any()


def test_a_robot_that_fails_on_the_way_stops_all_and_they_do_not_go_on(seen):
    rig = seen.rig
    rig.t = turn_to_stops(rig.session, ways(seen), rig.t)
    loaded = rig.session.loaded_plan
    failing = np.flatnonzero(loaded.started)[:1]
    rig.t = loaded.start_s + 0.4 * loaded.makespan_s
    rig.session.advance(rig.t)
    rig.robots.power(failing, False, rig.t)
    result = rig.run()
    assert len(rig.session.loaded_plans) == 2 and not rig.session.loaded_plan.started.any()
    failed = result.outcome == Outcome.FAILED
    assert np.array_equal(np.flatnonzero(failed), failing)
    robots = rig.session.robots
    assert robots["lost"][loaded.started].all() and not robots["seen"][loaded.started].any()


def test_robots_beside_one_at_an_unknown_place_or_without_a_gap_rest(seen):
    rig = seen.rig
    row = int(np.flatnonzero(seen.unknown)[0])
    way = np.where(np.arange(N) == row, 1.0, np.nan)
    rig.session.robots["turn_limit"][row] = 0
    with pytest.raises(SessionError, match=f"robot {row} is beside one at an unknown place, or"):
        turn_to_stops(rig.session, way, rig.t)
    rig.session.robots["turn_limit"][row] = 1000
    pairs = neighbour_pairs(rig.plane)
    beside = pairs[(pairs == row).any(axis=1) & (pairs < N).all(axis=1)]
    cut_power(rig, np.setdiff1d(beside, [row])[:1])
    assert str(rig.plane.ids[row]) in blocked_text(rig.session, way)
    with pytest.raises(SessionError, match="1 robots do not turn to a stop"):
        turn_to_stops(rig.session, way, rig.t)


def test_only_robots_that_were_seen_without_their_turn_turn_to_a_stop(seen):
    rig = seen.rig
    with pytest.raises(SessionError, match="no robot of these can be commanded and was seen"):
        turn_to_stops(rig.session, np.where(seen.unknown, np.nan, 1.0), rig.t)


def test_a_robot_that_errors_of_the_drive_may_bring_too_near_rests(seen):
    row = int(np.flatnonzero(seen.unknown)[0])
    way = np.where(np.arange(N) == row, -1.0, np.nan)
    of_move_mm = seen.rig.session.protocol.of_move_mm
    seen.rig.session.protocol.of_move_mm = of_move_mm + 2.0
    with pytest.raises(SessionError, match="too near to a neighbour"):
        seen.turn(way)
    seen.rig.session.protocol.of_move_mm = of_move_mm
    assert np.array_equal(np.flatnonzero(seen.turn(way)), [row])
