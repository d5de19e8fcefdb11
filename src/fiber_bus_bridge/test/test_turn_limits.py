# SPDX-License-Identifier: Apache-2.0
"""Test turns of robots at unknown places: what they add up to."""

from dataclasses import replace

import numpy as np
import pytest
from session_rig import Rig
from unplaced_rig import ALL, CONFIG, HALF_MM, N, cut_power, new_rig, place, remembered

from fiber_bus_bridge import SessionConfig
from fiber_bus_bridge.checked_file import read_checked, write_checked
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.measured_places import learn_intervals, place_robots
from fiber_bus_bridge.robot_memory import load_memory
from fiber_bus_bridge.unplaced_robots import turn_unplaced, turns_of
from fiber_core.clearance import Safety, gaps, levers_of, neighbour_pairs


class Arms:
    """How far the arms of a rig have been from where they were."""

    def __init__(self, rig):
        self.rig, self.theta, self.was = rig, np.zeros(N), rig.where()
        self.most_mm = np.zeros(N)

    def look(self):
        """Take over what the counters have turned since the last call."""
        now = self.rig.where()
        self.theta = self.theta + (now - self.was)[:, 0] * self.rig.units.quantum_rad
        self.was = now
        mm = np.abs(self.theta) * levers_of(self.rig.plane)[:, 0]
        self.most_mm = np.maximum(self.most_mm, mm)

    def forget(self):
        """The counters were set to other numbers; no arm has moved."""
        self.was = self.rig.where()


def test_turns_over_refusals_and_restarts_stay_within_half_the_margin(tmp_path):
    rig = new_rig()
    arms = Arms(rig)
    for night in range(4):
        for refused in (True, False, True, False):
            rig.t = turn_unplaced(rig.session, rig.t, lambda refused=refused: not refused)
            rig.run()
            arms.look()
        # and the next bridge begins after an odd number of turns
        rig.t = turn_unplaced(rig.session, rig.t)
        rig.run()
        arms.look()
        rig = new_rig(rig, remembered(rig, tmp_path / f"{night}.json"))
        arms.rig = rig
        arms.forget()
    assert (arms.most_mm > 0.9 * HALF_MM).all()
    assert (arms.most_mm <= HALF_MM + 1e-9).all()


def test_robots_with_both_elbows_in_range_turn_phi_to_both_ends_of_half_the_margin(tmp_path):
    phi_deg, most_mm = (-172.0, 172.0), np.zeros(N)
    rig, off, turns_mm = new_rig(phi_deg=phi_deg), np.zeros(N), []
    for turn in range(6):
        before = rig.where()
        rig.t = turn_unplaced(rig.session, rig.t)
        rig.run()
        moved = rig.where() - before
        assert not moved[:, 0].any()
        off += moved[:, 1]
        mm = rig.units.quantum_rad * levers_of(rig.plane)[:, 1]
        turns_mm.append(np.abs(moved[:, 1]) * mm)
        most_mm = np.maximum(most_mm, np.abs(off) * mm)
        if turn % 2:  # and the next bridge begins
            rig = new_rig(rig, remembered(rig, tmp_path / f"{turn}.json"), phi_deg=phi_deg)
    assert (most_mm > 0.9 * HALF_MM).all() and (most_mm <= HALF_MM + 1e-9).all()
    assert (turns_mm[0] < 1.01 * HALF_MM).all() and (turns_mm[1] > 1.8 * HALF_MM).all()


def test_a_phi_turn_that_is_broken_off_leaves_what_was_not_turned():
    rig = new_rig(phi_deg=(-172.0, 172.0))
    full = rig.session.robots["turn_limit"].copy()
    turned = break_turn_off(rig, [3], 0.3, joint=1)
    limit, others = rig.session.robots["turn_limit"], np.arange(N) != 3
    down, up = (limit - full)[others].T
    assert np.array_equal(down, -up)
    levers = levers_of(rig.plane)[others]
    assert (down * levers[:, 0] >= turned[others] * levers[:, 1] - 1e-9).all()
    assert limit[3, 0] == full[3, 0] and limit[3, 1] < full[3, 1] // 50


def test_a_turn_that_a_bridge_did_not_see_end_counts_as_made_and_as_not_made(tmp_path):
    rig = new_rig()
    kept = []

    def may_go(rig):
        kept.append(remembered(rig, tmp_path / "robots.json", starting=True))
        return True

    full = rig.session.robots["turn_limit"].copy()
    rig.t = turn_unplaced(rig.session, rig.t, lambda: may_go(rig))
    later = new_rig(memory=kept[0])  # the bridge was killed before or after the GO
    limit = later.session.robots["turn_limit"]
    assert np.array_equal(limit[:, 0], full[:, 0]) and (limit[:, 1] < full[:, 1] // 50).all()
    later.t = turn_unplaced(later.session, later.t, lambda: may_go(later))
    last = new_rig(memory=kept[1])
    with pytest.raises(
        SessionError, match=r"robot 0 may turn by 0\.00\d deg down and 0\.00\d deg up"
    ):
        turn_unplaced(last.session, last.t)


def test_a_memory_of_an_earlier_version_grants_no_turn(tmp_path):
    rig = new_rig()
    memory = remembered(rig, tmp_path / "robots.json")
    assert memory.turn_limit.all()
    content = read_checked(tmp_path / "robots.json", "robot memory of fiber_bus_bridge, 1")
    for name in ("checksum", "turn_down", "turn_up"):
        del content[name]
    write_checked(tmp_path / "robots.json", content, "memory")
    old = load_memory(tmp_path / "robots.json", rig.plane, rig.units.quantum_prad, 2)
    later = new_rig(memory=old)
    with pytest.raises(SessionError, match="robot 0 may turn by 0.000 deg down"):
        turn_unplaced(later.session, later.t)


def close_pair(rig, gap_mm):
    """Counts at which two neighbours are a gap apart, by a turn of theta of one of them."""
    counts = rig.session.counts.copy()
    pairs = neighbour_pairs(rig.plane)
    pairs = pairs[(pairs < N).all(axis=1)]
    turns = np.linspace(-3.0, 3.0, 6001)
    for a, b in pairs:
        for phi in (0.6, 1.2):
            angles = np.array(rig.units.to_angles(counts))
            angles[[a, b], 1] = phi
            angles[b, 0] = (
                np.arctan2(*(rig.plane.centers[a] - rig.plane.centers[b])[::-1]) - phi / 2
            )
            for turn in turns:
                angles[a, 0] = turn
                gap = gaps(rig.plane, [[a, b]], angles)[0]
                others = gaps(rig.plane, pairs, angles)
                if abs(gap - gap_mm) < 0.002 and (np.sort(others)[1] > 0.06):
                    return rig.units.encoder_counts(rig.plane, angles), (a, b)
    raise AssertionError("no pair comes so close")


def test_a_pair_that_a_camera_saw_closer_than_the_margin_does_not_turn_together(tmp_path):
    rig = new_rig()
    counts, pair = close_pair(rig, 0.01)
    place(rig, counts, ALL)
    assert rig.session.usable.all()
    cut_power(rig, np.arange(N))
    later = new_rig(rig, remembered(rig, tmp_path / "robots.json"))
    before = later.where()
    later.t = turn_unplaced(later.session, later.t)
    later.run()
    moved = (later.where() != before).any(axis=1)
    assert not moved[list(pair)].any() and moved.sum() > N // 2


def test_robots_that_are_placed_again_turn_as_far_as_their_gaps_allow():
    rig = new_rig()
    arms = Arms(rig)
    for _ in range(3):
        # all turn, are found where they are, and lose their power before any plan
        rig.t = turn_unplaced(rig.session, rig.t)
        rig.run()
        arms.look()
        place(rig, rig.where(), ALL)
        cut_power(rig, np.arange(N))
        arms.forget()
    at = rig.units.to_angles(rig.where())
    assert gaps(rig.plane, neighbour_pairs(rig.plane), at).min() > 0.0


def test_a_robot_beside_one_that_is_not_found_keeps_its_limit_when_it_is_found():
    rig = new_rig()
    arms = Arms(rig)
    found = ALL.copy()
    found[0] = False  # the robot in the middle is dark
    for _ in range(4):
        rig.t = turn_unplaced(rig.session, rig.t)
        rig.run()
        arms.look()
        place(rig, rig.where(), found)
        cut_power(rig, np.flatnonzero(found))
        arms.forget()
    beside = neighbour_pairs(rig.plane)
    beside = np.unique(beside[(beside == 0).any(axis=1) & (beside < N).all(axis=1)])
    assert (arms.most_mm[beside] <= HALF_MM + 1e-9).all()


def break_turn_off(rig, rows, share, joint=0):
    """Let robots lose their power when a test turn is made in part; return what they turned."""
    before = rig.where()
    rig.t = turn_unplaced(rig.session, rig.t)
    loaded = rig.session.loaded_plan
    rig.t = loaded.start_s + share * loaded.makespan_s
    rig.session.advance(rig.t)
    turned = (rig.where() - before)[:, joint]
    rig.robots.power(rows, False, rig.t)
    rig.run()
    return turned


def recalled_rig():
    rig = new_rig()
    place(rig, rig.where(), ALL)
    cut_power(rig, np.arange(N))
    assert rig.session.robots["recalled"].all()
    return rig


def test_robots_that_are_dark_after_each_restart_turn_no_farther_than_their_gaps(tmp_path):
    rig = recalled_rig()
    total, most = np.zeros(N), np.zeros(N)
    for night in range(4):
        try:
            total += break_turn_off(rig, np.arange(N), 0.97)
            most = np.maximum(most, np.abs(total))
        except SessionError as refusal:
            assert night > 0 and "robot 0 may turn by 0.000 deg down" in str(refusal)
            break
        rig = new_rig(rig, remembered(rig, tmp_path / "robots.json"))  # no robot answers
        assert rig.session.robots["lost"].all()
        rig.robots.power(np.arange(N), True, rig.t)
        rig.t += 0.1
        rig.call("configure")
    moved_mm = most * rig.units.quantum_rad * levers_of(rig.plane)[:, 0]
    assert (moved_mm > 0.9 * HALF_MM).all() and (moved_mm <= HALF_MM + 1e-9).all()
    assert night < 3


def test_a_robot_that_loses_its_power_in_a_test_turn_does_not_rest_where_it_did(tmp_path):
    rig = recalled_rig()
    place(rig, rig.where(), np.arange(N) != 0)  # all but one are found
    break_turn_off(rig, [0], 0.9)
    assert not rig.session.robots["recalled"][0]
    with pytest.raises(SessionError, match="robot 0 cannot be vouched for"):
        rig.session.vouch([0])
    memory = remembered(rig, tmp_path / "robots.json")
    assert not memory.placed[0] and memory.lost[0]
    later = new_rig(rig, memory)  # the robot stays dark
    later.session.submit(later.orders(0, -400))
    later.call("start")
    beside = neighbour_pairs(rig.plane)
    beside = np.unique(beside[(beside == 0).any(axis=1) & (beside < N).all(axis=1)])
    started = later.session.loaded_plan.started
    assert not started[beside].any() and started.any()


def test_the_file_tells_before_the_go_that_a_turning_robot_rests_at_no_known_place(tmp_path):
    rig = recalled_rig()
    kept = []

    def may_go():
        kept.append(remembered(rig, tmp_path / "robots.json", starting=True))
        return True

    rig.t = turn_unplaced(rig.session, rig.t, may_go)
    kept.append(remembered(rig, tmp_path / "robots.json"))  # and while they turn
    for memory in kept:
        assert not memory.placed.any() and memory.lost.all()
    rig.run()
    arrived = remembered(rig, tmp_path / "robots.json")
    assert arrived.placed.all()  # the counters tell how far they have turned


def test_robots_that_were_read_at_rest_get_back_what_they_have_not_turned():
    rig = new_rig()
    full = rig.session.robots["turn_limit"].copy()
    turned = break_turn_off(rig, [3], 0.3)
    others = np.arange(N) != 3
    limit = rig.session.robots["turn_limit"]
    # they went on until all were stopped
    down, up = (limit - full)[others].T
    assert np.array_equal(down, -up) and (down >= turned[others]).all()
    assert (up > -full[others, 1]).all()
    assert limit[3, 0] == full[3, 0] and limit[3, 1] < full[3, 1] // 50
    rig.robots.power([3], True, rig.t)
    rig.t += 0.1
    rig.call("configure")
    before = rig.where()
    rig.t = turn_unplaced(rig.session, rig.t)  # no robot is left stopped
    rig.run()
    assert (rig.where() != before).any(axis=1).all()


def test_the_limits_before_the_go_of_home_hold_what_its_move_leaves_unknown(tmp_path):
    rig, kept = new_rig(), []
    place(rig, rig.where(), ALL)  # an image: the counters are true until the next move
    pairs = neighbour_pairs(rig.plane)
    pairs = pairs[(pairs < N).all(axis=1)]
    gap_mm = gaps(rig.plane, pairs, rig.session.angles)
    closest = list(pairs[np.argmin(gap_mm)])
    move_mm = 0.5 * (gap_mm.min() - HALF_MM)  # after which half of the margin may be left
    rig.session.protocol.of_move_mm = np.full((N, 2), move_mm)

    def may_go():
        kept.append(remembered(rig, tmp_path / "robots.json", starting=True))
        return True

    rig.call("home", may_go)
    assert rig.session.loaded_plan.started[closest].all()
    lever_mm = levers_of(rig.plane)[closest, 0]
    turn_mm = kept[0].turn_limit[closest].max(axis=1) * rig.units.quantum_rad * lever_mm
    assert (turn_mm <= 0.5 * HALF_MM).all()


def following_pair(path):
    """A rig in which a robot follows its neighbour closely, the pair, and what was kept."""
    rig = new_rig()
    counts, pair = close_pair(rig, 0.06)
    pair = list(pair)
    place(rig, counts, ALL)
    step_rad, angles = 1e-5, np.array(rig.session.angles)
    gap_mm, slope = gaps(rig.plane, [pair], angles)[0], []
    for robot in pair:
        turned = angles.copy()
        turned[robot, 0] += step_rad
        slope.append((gaps(rig.plane, [pair], turned)[0] - gap_mm) / step_rad)
    # one withdraws a little faster than the other comes
    rate = np.array([1.05, -1.0]) / slope
    speed = rig.session.protocol.speed[pair, 0]
    velocity = np.zeros(N)
    velocity[pair] = np.trunc(0.5 * rate * (speed / np.abs(rate)).min())
    ticks = round(0.03 / (rig.units.tick_us * 1e-6))
    rig.session.submit(rig.orders(velocity, 0, ticks=ticks))
    kept = []

    def may_go():
        kept.append(remembered(rig, path, starting=True))
        return True

    rig.call("start", may_go)
    assert rig.session.loaded_plan.started[pair].all()
    return rig, pair, kept[0]


def test_a_motion_that_is_broken_off_leaves_gaps_for_the_turns_that_are_on_disk(tmp_path):
    rig, pair, memory = following_pair(tmp_path / "robots.json")
    loaded = rig.session.loaded_plan
    # one stops a stop skew before the other, anywhere on the way
    steps = np.linspace(0.0, loaded.makespan_s, 400)
    angles = np.stack([loaded.motion.decoded()(t) for t in steps])
    late = round(Safety().stop_skew_s / steps[1])
    broken_off = []
    for a in pair:
        mixed = angles[:-late].copy()
        mixed[:, a] = angles[late:, a]
        broken_off.append(gaps(rig.plane, [pair], each)[0] for each in mixed)
    least_mm = min(map(min, broken_off))
    rad = memory.turn_limit[pair].max(axis=1) * rig.units.quantum_rad
    assert (rad * levers_of(rig.plane)[pair, 0]).sum() <= least_mm < 2.0 * HALF_MM
    assert np.array_equal(memory.turn_limit, rig.session.robots["turn_limit"])
    rig.run()
    at_rest_mm = gaps(rig.plane, [pair], rig.session.angles)[0]
    rad = rig.session.robots["turn_limit"][pair].max(axis=1) * rig.units.quantum_rad
    assert (rad * levers_of(rig.plane)[pair, 0]).sum() <= at_rest_mm


def test_intervals_of_an_image_outlive_a_restart(tmp_path):
    rig = new_rig()
    counts, pair = close_pair(rig, 0.055)
    place_robots(rig.session, counts, ALL, rig.t)
    learn_intervals(rig.session, np.full(N, 0.03), 0.03)
    limit = rig.session.robots["turn_limit"].copy()
    assert not limit[list(pair)].any()
    later = new_rig(rig, remembered(rig, tmp_path / "robots.json"))
    assert later.session.usable.all()
    assert np.array_equal(later.session.robots["turn_limit"], limit)


def test_places_that_are_vouched_for_make_the_limits_of_close_pairs_smaller():
    rig = new_rig()
    counts, pair = close_pair(rig, 0.01)
    later = Rig(N, start=rig.units.to_angles(counts), config=CONFIG, volatile=True)
    later.robots.power(np.arange(N), False, 0.0)
    later.call("configure")
    later.session.vouch(later.plane.ids)
    limit = later.session.robots["turn_limit"][list(pair)]
    used_mm = limit.max(axis=1) * rig.units.quantum_rad * levers_of(rig.plane)[list(pair), 0]
    assert 0.0 < used_mm.sum() <= gaps(rig.plane, [list(pair)], later.session.angles)[0]


def test_a_session_that_believes_counters_keeps_no_turns_for_one_that_does_not(tmp_path):
    rig = Rig(N, config=SessionConfig(), volatile=True)
    rig.call("configure")
    memory = remembered(rig, tmp_path / "robots.json")
    assert memory.turn_limit is None
    rig.robots.power(np.arange(N), False, rig.t)
    rig.robots.power(np.arange(N), True, rig.t)
    rig.t += 0.1
    later = new_rig(rig, memory)
    with pytest.raises(SessionError, match="robot 0 may turn by 0.000 deg down"):
        turn_unplaced(later.session, later.t)


def test_gaps_hold_what_the_drive_leaves_unknown():
    def limits(uncertainty_rad):
        rig = new_rig()
        counts, pair = close_pair(rig, 0.055)
        c = rig.session.protocol
        c.plane = replace(
            c.plane, drive=replace(c.plane.drive, uncertainty_rad=np.full((N, 2), uncertainty_rad))
        )
        place(rig, counts, ALL)
        return rig.session.robots["turn_limit"][list(pair)]

    assert (limits(2e-3) < limits(0.0)).all()


def test_a_robot_that_may_turn_only_the_other_way_is_named():
    rig = new_rig()
    rig.session.robots["turn_limit"][:3, 1] = 0
    rig.session.robots["turn_limit"][3:8, 0] = 0
    turn, refused = turns_of(rig.session)
    assert np.array_equal(turn == 0, refused) and refused.sum() == 3
