# SPDX-License-Identifier: Apache-2.0
"""What vouches for the place of a robot whose counters tell nothing, and what is on disk of it."""

from dataclasses import replace

import numpy as np
import pytest
from session_rig import Rig
from unplaced_rig import ALL, CONFIG, N, cut_power, new_rig, place, remembered

from fiber_bus_bridge import SessionState
from fiber_bus_bridge.errors import BridgeError, SessionError
from fiber_bus_bridge.robot_memory import load_memory
from fiber_core.clearance import neighbour_pairs
from fiber_core.outcomes import Reason


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


def jammed_rig(path):
    """A rig of which a joint of robot 5 did not follow, and the memory from before the GO."""
    rig = Rig(N, config=replace(CONFIG, resumes=0), volatile=True)
    rig.call("configure")
    place(rig, rig.where(), ALL)
    rig.session.submit(rig.orders(400, 0))
    kept = []

    def may_go():
        kept.append(remembered(rig, path, starting=True))
        return True

    rig.call("start", may_go)
    rig.robots.memory["jam_s"][5] = rig.t + 0.1
    rig.run()
    assert rig.session.robots["unplaced"][5]
    return rig, kept[0]


def next_rig(rig, memory, path):
    """A session after the one that remembered something; it keeps its memory in a file."""
    later = Rig(N, config=CONFIG, robots=rig.robots, volatile=True)
    later.t = rig.t
    later.session.recall(memory)
    later.session.protocol.save = lambda: remembered(later, path)
    later.call("configure")
    return later


def load(rig, path):
    return load_memory(path, rig.plane, rig.units.quantum_prad, len(rig.session.buses))


@pytest.mark.parametrize("restarts", [1, 2, 3])
def test_a_joint_that_did_not_follow_is_not_forgotten_by_bridges_that_die(tmp_path, restarts):
    path = tmp_path / "robots.json"
    rig, memory = jammed_rig(path)
    for _ in range(restarts):
        rig = next_rig(rig, memory, path)
        memory = load(rig, path)  # what was on disk before the last CONFIG or CLEAR
        assert rig.session.robots["unplaced"][5] and not rig.session.usable[5]
    beside = neighbour_pairs(rig.plane)
    beside = np.unique(beside[(beside == 5).any(axis=1) & (beside < N).all(axis=1)])
    assert not memory.turn_limit[beside].any() and memory.turn_limit.any()


def test_a_joint_that_did_not_follow_is_on_disk_before_robots_are_cleared(tmp_path):
    path = tmp_path / "robots.json"
    rig, _ = jammed_rig(path)
    rig.session.protocol.save = lambda: remembered(rig, path)
    rig.call("clear")
    later = next_rig(rig, load(rig, path), path)
    assert later.session.robots["unplaced"][5] and later.session.state is SessionState.STOPPED


def test_robots_are_neither_configured_nor_cleared_without_a_place_on_disk(tmp_path):
    rig, memory = jammed_rig(tmp_path / "robots.json")

    def full():
        raise BridgeError("no space left on device")

    rig.session.protocol.save = full
    alerts = rig.robots.memory["alerts"].copy()
    with pytest.raises(BridgeError, match="no space left"):
        rig.call("clear")
    later = Rig(N, config=CONFIG, robots=rig.robots, volatile=True)
    later.t = rig.t
    later.session.recall(memory)
    later.session.protocol.save = full
    with pytest.raises(BridgeError, match="no space left"):
        later.call("configure")
    assert np.array_equal(rig.robots.memory["alerts"], alerts) and alerts[5]
    later.session.protocol.save = lambda: None
    later.call("configure")
    assert later.session.robots["unplaced"][5]
