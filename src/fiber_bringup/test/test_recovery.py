# SPDX-License-Identifier: Apache-2.0
"""Robots whose counters tell nothing, through the nodes: found with a camera and in use again."""

import numpy as np
import pytest
from night import COMPILE_S, WAIT_S, Night

from fiber_bus_bridge.plant import touching
from fiber_bus_bridge.simulation import Event, true_angles
from fiber_client.recover import main as recover_command
from fiber_client.recover import recover
from fiber_core import kinematics
from fiber_core.clearance import Safety
from fiber_core.outcomes import Outcome
from fiber_msgs_py import layout, topics
from fiber_recording import load_recording

NIGHT = {"simulation": {"volatile": True}, "session.counters_kept": False}


@pytest.fixture(scope="module")
def night(tmp_path_factory, new_domain):
    folder = tmp_path_factory.mktemp("night")
    made = Night(folder, new_domain(), memory=str(folder / "memory.json"), **NIGHT)
    yield made
    made.end()


def cut_power(night, rows):
    robots, now_s = night.plant.robots, night.plant.now_s
    robots.power(rows, False, now_s)
    robots.power(rows, True, now_s + 1e-3)


def off_um(night):
    """Distance of the true fibres from where the counters put them [um]."""
    plane = night.client.plane
    told = kinematics.forward(plane, night.client.angles)[1]
    return 1e3 * np.hypot(*(night.true_fibres() - told).T)


def check_found(night, ended, rows):
    ids = night.client.plane.ids
    lit = night.camera._lit[rows]
    assert set(ended.lost) == set(ids[rows])
    assert set(ended.left) <= set(ids[rows][~lit])  # dark fibres tell no camera anything
    assert len(ended.found) + len(ended.turn_unknown) + len(ended.left) == len(rows)
    seen = np.isin(ids, np.concatenate([ended.found, ended.turn_unknown]))
    assert off_um(night)[seen].max() < 20.0


def turns_are_true(night):
    """Whether theta of each robot in use is that of its true arm, with its turn."""
    night.true_fibres()  # the arms follow until now
    true = true_angles(night.camera._mechanics, night.camera._arms)[:, 0]
    rows = night.client.plane.enabled & night.camera._lit
    return bool(np.abs(true - night.client.angles[:, 0])[rows].max() < 0.5)


def moves_again(night, seed):
    ids, xy_mm = night.field(seed)
    blind = night.client.reconfigure(ids, xy_mm, COMPILE_S)
    return blind.of(ids)


def nothing_touched(night):
    camera = night.camera
    truth = camera._truth.since(0)
    exact = night.graph.nodes[0]._hardware.plane
    return not touching(exact, truth, camera._mechanics).unsafe.any()


def test_at_first_all_robots_are_at_unknown_places_and_most_come_into_use(night):
    # no memory tells where they rested
    n = night.client.plane.n
    assert (night.client.unplaced == 1).all() and not night.client.plane.enabled.any()
    before = night.true_fibres()
    ended = recover(night.client, COMPILE_S, to_stops=False)
    check_found(night, ended, np.arange(n))
    assert len(ended.found) >= 0.8 * n and len(ended.turn_unknown) > 0
    moved_mm = np.hypot(*(night.true_fibres() - before).T)
    assert 0.0 < moved_mm.max() <= 0.5 * night.graph.nodes[0]._session.protocol.safety.margin_mm
    assert nothing_touched(night)
    usable = night.client.plane.enabled
    assert usable.sum() == len(ended.found)
    ended = moves_again(night, 1)
    assert ended.count(Outcome.REACHED) > 0.5 * n


def test_some_robots_that_lose_their_power_at_rest_come_back_with_their_turn(night):
    usable = np.flatnonzero(night.client.plane.enabled & night.camera._lit)
    rows = usable[::5]
    cut_power(night, rows)
    ended = recover(night.client, COMPILE_S, to_stops=False)
    fresh = np.isin(night.client.plane.ids[rows], ended.lost)
    assert fresh.all()
    # the memory tells the turn of these, and images all else
    assert set(night.client.plane.ids[rows]) <= set(ended.found)
    assert off_um(night)[rows].max() < 20.0
    assert night.client.plane.enabled[rows].all() and nothing_touched(night)
    assert moves_again(night, 2).count(Outcome.REACHED) > 0.5 * night.client.plane.n
    assert turns_are_true(night)


def test_a_bus_that_loses_its_power_comes_back(night):
    bus = night.client.plane.bus
    rows = np.flatnonzero(bus == bus[0])
    in_use = night.client.plane.enabled[rows] & night.camera._lit[rows]
    cut_power(night, rows)
    ended = recover(night.client, COMPILE_S, to_stops=False)
    assert set(night.client.plane.ids[rows][in_use]) <= set(ended.found)
    assert off_um(night)[rows[in_use]].max() < 20.0 and nothing_touched(night)


def test_robots_whose_power_fails_in_motion_come_back(night):
    client, plant = night.client, night.plant
    usable = np.flatnonzero(client.plane.enabled & night.camera._lit)
    rows = usable[1::4]
    ids, xy_mm = night.field(3)
    stamp = client.send_targets(ids, xy_mm)
    client.wait_until_ready(stamp, WAIT_S)
    begin = plant.now_s
    # half a second after the start, as seen by the robots alone
    plant.robots.schedule(
        [
            (row, begin + 1.0 + at, Event.POWER, on)
            for row in rows
            for on, at in ((0, 0.0), (1, 0.1))
        ]
    )
    client.start(WAIT_S)
    failed = client.wait_for_outcome(stamp, WAIT_S).of(client.plane.ids[rows])
    plant.robots.schedule(())
    assert failed.count(Outcome.FAILED) > 0
    client.call_service(topics.CLEAR, WAIT_S)
    ended = recover(client, COMPILE_S, to_stops=False)
    assert set(ended.lost) >= set(client.plane.ids[rows])
    check_lit = np.isin(client.plane.ids, np.concatenate([ended.found, ended.turn_unknown]))
    assert turns_are_true(night)
    assert check_lit[rows].mean() > 0.9 and off_um(night)[rows[check_lit[rows]]].max() < 20.0
    assert nothing_touched(night)


def test_a_bridge_that_begins_anew_remembers_which_places_are_unknown(night):
    # it has only its memory on disk; these robots have answered it, and have not been found
    rows = np.flatnonzero(night.client.plane.enabled & night.camera._lit)[::6]
    cut_power(night, rows)
    night.client.call_service(topics.CONFIGURE, WAIT_S)
    night.client.wait_for(lambda: (night.client.unplaced[rows] == layout.RECALLED).all(), WAIT_S)
    before = night.client.session
    bridge = night.graph.nodes[0]
    assert bridge.trigger_deactivate() and bridge.trigger_cleanup()
    assert bridge.trigger_configure() and bridge.trigger_activate()
    night.client.wait_for(lambda: night.client.session != before, WAIT_S)
    night.client.wait_for(lambda: (night.client.unplaced[rows] > 0).all(), WAIT_S)
    ended = recover(night.client, COMPILE_S, to_stops=False)
    assert set(night.client.plane.ids[rows]) <= set(ended.found)


def test_robots_of_which_another_turn_is_in_range_turn_to_their_stops(night):
    client = night.client
    wide = client.plane.ids[client.unplaced == layout.SEEN]
    before = night.true_fibres()
    told = []
    ended = recover(client, COMPILE_S, say=told.append)
    assert set(wide) <= set(ended.lost) and len(ended.turn_unknown) < len(wide)
    assert len(ended.notes) == len(ended.turn_unknown) and ended.stop_turns > 0
    assert f"after turn {ended.stop_turns} to stops:" in "\n".join(told)
    moved_mm = np.hypot(*(night.true_fibres() - before).T)
    rows = client.plane.index_of(wide)
    assert moved_mm[rows].max() > 0.1  # and the others have rested, but for test turns
    assert np.delete(moved_mm, rows).max() <= Safety().margin_mm
    assert turns_are_true(night) and nothing_touched(night)


def test_the_command_finds_all_robots_after_a_loss_of_all_power(night, monkeypatch, capfd):
    lit, in_use = night.camera._lit, night.client.plane.enabled.copy()
    cut_power(night, np.arange(night.client.plane.n))
    monkeypatch.setenv("ROS_DOMAIN_ID", str(night.domain))
    code = recover_command([])
    told = capfd.readouterr().out
    assert f"{night.client.plane.n} robots at unknown places" in told
    assert code == (0 if (lit & in_use).all() else 1)
    night.client.wait_for(lambda: night.client.plane.enabled[lit & in_use].all(), WAIT_S)
    night.client.wait_for(lambda: off_um(night)[lit & in_use].max() < 20.0, WAIT_S)
    assert nothing_touched(night)


def test_recordings_are_made_of_motions_with_images_and_losses_of_power_near_them(night):
    told = [str(each) for refusals in night.client.refusals.values() for each in refusals]
    assert not [text for text in told if "not recorded" in text]
    night.client.wait_for(
        lambda: len(list(night.recordings.glob("*.npz"))) >= 10, WAIT_S, "ten recordings"
    )
    for path in night.recordings.glob("*.npz"):
        recording = load_recording(path)
        assert recording.executed.fastest.max() < 2.0 * recording.problem.plane.speeds.max()
