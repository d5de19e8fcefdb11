# SPDX-License-Identifier: Apache-2.0
"""What the memory of a bridge grants to robots at unknown places, and when it is written."""

import os
from types import SimpleNamespace

import numpy as np
import pytest
from session_rig import Rig
from test_node_memory import unfolding
from test_turn_limits import ALL, CONFIG, N, close_pair, new_rig, place

from fiber_bus_bridge import BridgeError, SessionState
from fiber_bus_bridge.availability import Availability
from fiber_bus_bridge.node.outlines import BlindErrors, Outlines
from fiber_bus_bridge.node.remembered import Remembered
from fiber_bus_bridge.unplaced_robots import turn_unplaced
from fiber_msgs_py import topics

pytestmark = pytest.mark.timeout(600)


def remembering(rig, path, plant=None, outlive=True):
    """The memory of a session in a file, and what it warns of."""
    told = []
    hardware = SimpleNamespace(plant=plant, plane=rig.plane, robots_outlive=outlive)
    return Remembered(rig.session, Availability(rig.plane), hardware, path, told.append), told


def next_rig(rig):
    later = Rig(N, config=CONFIG, robots=rig.robots, volatile=True)
    later.t = rig.t
    return later


@pytest.mark.parametrize(("outlive", "turns"), [(True, False), (False, True)])
def test_without_a_memory_robots_that_outlive_the_bridge_do_not_turn(outlive, turns):
    rig = next_rig(new_rig())
    _, told = remembering(rig, None, outlive=outlive)
    assert rig.session.robots["turn_limit"].any() == turns
    assert turns or "robots at unknown places do not turn: memory is none" in told[0]


def test_the_memory_of_a_plant_holds_whatever_the_clock_says(tmp_path):
    plant, path = tmp_path / "plant", tmp_path / "robots.json"
    plant.touch()
    rig = new_rig()
    memory, _ = remembering(rig, path, plant)
    rig.t = turn_unplaced(rig.session, rig.t)
    rig.run()
    memory.save()
    limit = rig.session.robots["turn_limit"].copy()
    os.utime(path, (0, 0))  # the clock was set back
    later = next_rig(rig)
    _, told = remembering(later, path, plant)
    assert np.array_equal(later.session.robots["turn_limit"], limit) and not told
    plant.unlink()
    plant.touch()
    os.utime(plant, (1, 1))
    later = next_rig(rig)
    _, told = remembering(later, path, plant)
    assert not later.session.robots["turn_limit"].any()
    assert "robots.json is of another plant" in told[0]


def test_what_is_saved_before_robots_are_configured_tells_of_no_motion(tmp_path):
    rig = new_rig()
    rig.call("stop")  # of another controller: no memory tells of it
    for _ in range(2):
        later = next_rig(rig)
        memory, _ = remembering(later, tmp_path / "robots.json")
        kept = []

        def save(session=later.session, memory=memory, kept=kept):
            kept.append(session.memory(np.zeros(N, dtype=np.int64)))
            memory.save()

        later.session.protocol.save = save
        later.call("configure")
        assert later.session.state is SessionState.STOPPED
        assert not kept[0].moving
    later.call("clear")
    assert kept[1].stopped and not kept[1].moving


def test_until_an_image_is_taken_limits_hold_the_errors_of_blind_moves(tmp_path):
    rig = new_rig()
    counts, pair = close_pair(rig, 0.055)
    place(rig, counts, ALL)
    memory, _ = remembering(rig, tmp_path / "robots.json")
    memory.save()
    limit = rig.session.robots["turn_limit"].copy()
    later = next_rig(rig)
    outlines = Outlines(later.session, later.plane, BlindErrors(blind_um=40.0), None)
    remembering(later, tmp_path / "robots.json")
    later.call("configure")
    assert later.session.usable.all()
    assert not later.session.robots["turn_limit"][list(pair)].any()
    outlines.learn(np.zeros((N, 2)))
    # outlines are those of a blind move again, and full turns a little smaller
    assert (later.session.robots["turn_limit"] > 0.9 * limit).all()
    outlines.move_blind()
    later.call("configure")
    assert not later.session.robots["turn_limit"][list(pair)].any()


def unplaced(a_night):
    return a_night.bridge._session.robots["unplaced"]


def believes_no_counters(a_night, **given):
    a_night.given |= {"session__counters_kept": False} | given
    a_night.restart()
    assert not unplaced(a_night).any()  # the bridge before knew where they rest


def test_a_bridge_that_dies_once_it_has_configured_has_saved_which_joint_did_not_follow(
    night,
    monkeypatch,
):
    believes_no_counters(night)
    night.ready(9, unfolding(ticks=300))
    assert night.call(topics.START).success
    night.jam(5)
    with monkeypatch.context() as patch:  # the next bridge dies before it saves at rest
        patch.setattr("fiber_bus_bridge.node.remembered.Remembered.save_or_warn", lambda _: None)
        night.restart()
        assert np.flatnonzero(unplaced(night)).tolist() == [5]
    night.restart()
    assert np.flatnonzero(unplaced(night)).tolist() == [5]
    assert not night.bridge._session.usable[5]


def test_without_a_place_on_disk_a_plan_ends_without_another_attempt(night, monkeypatch):
    believes_no_counters(night, attempts=2, session__resumes=0)
    night.ready(9, unfolding(ticks=300))
    assert night.call(topics.START).success

    def full(*_):
        raise BridgeError("no space left on device")

    monkeypatch.setattr("fiber_bus_bridge.node.remembered.save_memory", full)
    night.jam(5)
    night.end(9)
    assert night.bridge._session.state is SessionState.STOPPED
    assert night.robots.memory["alerts"][5]
    night.until(lambda: "no space left on device" in night.status().text)
