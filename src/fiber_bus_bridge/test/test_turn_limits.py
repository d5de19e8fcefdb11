# SPDX-License-Identifier: Apache-2.0
"""Test turns of robots at unknown places: what they add up to, and what vouches for a robot."""

import numpy as np
import pytest
from session_rig import Rig

from fiber_bus_bridge import SessionConfig
from fiber_bus_bridge.checked_file import read_checked, write_checked
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.measured_places import learn_intervals, place_robots
from fiber_bus_bridge.robot_memory import load_memory, save_memory
from fiber_bus_bridge.unplaced_robots import turn_unplaced
from fiber_core.clearance import Safety, gaps, levers_of, neighbour_pairs
from fiber_core.outcomes import Reason

CONFIG = SessionConfig(counters_kept=False)
HALF_MM = 0.5 * Safety().margin_mm
N = 19
ALL = np.ones(N, dtype=bool)


def new_rig(before=None, memory=None):
    """A session that begins; the robots are those of an earlier one."""
    rig = Rig(N, config=CONFIG, robots=before and before.robots, volatile=True)
    rig.t = before.t if before else 0.0
    if memory is not None:
        rig.session.recall(memory)
    rig.call("configure")
    return rig


def cut_power(rig, rows):
    rig.robots.power(np.asarray(rows), False, rig.t)
    rig.robots.power(np.asarray(rows), True, rig.t)
    rig.t += 0.1
    rig.call("configure")


def place(rig, counts, chosen, turn_known=True):
    """Tell robots where a camera has seen them, without an error."""
    place_robots(rig.session, counts, chosen, rig.t, turn_known)
    learn_intervals(rig.session, rig.plane, 0.0, 0.0)


def remembered(rig, path, starting=False):
    """The memory of a session, by way of its file."""
    memory = rig.session.memory(np.zeros(N, dtype=np.int64), starting)
    save_memory(path, memory, rig.plane, rig.units.quantum_prad)
    return load_memory(path, rig.plane, rig.units.quantum_prad, len(rig.session.buses))


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


def seen_rig():
    """A rig with robots of which a camera has told all but the turn of theta."""
    rig = new_rig()
    place(rig, rig.where(), ALL)
    rows = np.array([0, 7])
    cut_power(rig, rows)
    place(rig, rig.where(), ALL, turn_known=~ALL)
    assert rig.session.robots["seen"][rows].all()
    return rig, rows


def test_a_place_that_was_only_seen_vouches_for_nothing_after_the_next_loss_of_power():
    rig, rows = seen_rig()
    cut_power(rig, rows)
    assert rig.session.robots["unplaced"][rows].all()
    assert not rig.session.robots["recalled"][rows].any()


def test_a_place_that_was_only_seen_vouches_for_nothing_after_a_restart(tmp_path):
    rig, rows = seen_rig()
    memory = remembered(rig, tmp_path / "robots.json")
    assert not memory.placed[rows].any() and memory.placed.sum() == N - len(rows)
    later = new_rig(rig, memory)
    assert later.session.robots["unplaced"][rows].all()
    assert not later.session.robots["recalled"][rows].any()
    assert later.session.robots["lost"][rows].all()


def test_an_operator_cannot_vouch_for_counters_that_the_bridge_has_set():
    rig = new_rig()  # nothing tells where these robots rest
    with pytest.raises(SessionError, match="robot 3 cannot be vouched for: the bridge has set its"):
        rig.session.vouch([3])
    assert rig.session.robots["unplaced"].all()


def test_a_robot_that_was_only_seen_gets_no_orders_and_does_not_go_home():
    rig, rows = seen_rig()
    before = rig.where()
    rig.session.submit(rig.orders(400, 0))
    rig.call("start")
    assert not rig.session.loaded_plan.started[rows].any()
    assert (rig.session.loaded_plan.reason[rows] == Reason.PLACE_UNKNOWN).all()
    rig.run()
    rig.call("home")
    rig.run()
    assert np.array_equal(rig.where()[rows], before[rows])
    assert (rig.where() != before).any()
