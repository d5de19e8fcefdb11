# SPDX-License-Identifier: Apache-2.0
"""The decisions of the protocol, from tables alone."""

import numpy as np
import pytest

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.protocol.decisions import (
    able_to_resume,
    countdown_s,
    failing,
    neighbours_of,
    not_loaded,
    own_fault,
    record_heartbeats,
    silent_stop_s,
    unresponsive,
)
from fiber_bus_bridge.protocol.tables import begin_watch, new_buses, new_robots
from fiber_bus_bridge.wire import COUNTDOWN_S, Alert, RobotState
from fiber_core.outcomes import Reason

SILENCE_S, PERIOD_S, STRETCH_S = 5e-3, 2.5e-3, 1e-3


def test_neighbours_are_the_other_robots_of_pairs_with_a_lost_one_and_never_obstacles():
    pairs = np.array([[0, 1], [1, 2], [2, 3], [0, 4], [3, 5], [1, 5]])  # 4 and 5 are obstacles
    lost = np.array([False, True, False, False])
    assert neighbours_of(lost, pairs).tolist() == [True, False, True, False]
    assert neighbours_of(np.array([True, True, False, False]), pairs).tolist() == [
        True, True, True, False,
    ]  # fmt: skip
    assert not neighbours_of(np.zeros(4, dtype=bool), pairs).any()


def test_a_robot_that_is_not_verified_has_the_reason_of_its_acknowledge():
    ack = np.array([Ack.OK, Ack.OK, Ack.REFUSED, Ack.NO_ADDRESS, Ack.NO_ADDRESS])
    verified = np.array([True, False, False, False, True])
    no, yes = np.zeros(5, dtype=bool), np.ones(5, dtype=bool)
    assert not_loaded(verified, ack, yes, no, no).tolist() == [
        Reason.OK, Reason.NOT_VERIFIED, Reason.REFUSED, Reason.NOT_ACKNOWLEDGED, Reason.OK,
    ]  # fmt: skip
    assert not_loaded(no, ack, no, no, no).tolist() == [
        Reason.NOT_VERIFIED, Reason.NOT_VERIFIED, Reason.REFUSED, Reason.NO_REPLY, Reason.NO_REPLY,
    ]  # fmt: skip
    # a boot and a stuck bus explain everything else
    assert set(not_loaded(no, ack, yes, yes, yes)) == {Reason.REBOOTED}
    assert set(not_loaded(no, ack, no, no, yes)) == {Reason.BUS_FAILED}


def test_a_robot_has_the_fault_of_its_last_status():
    robots = new_robots(np.zeros((6, 2), dtype=np.int64))
    S = RobotState
    robots["state"] = [S.STOPPED, 0, 0, S.UNCONFIGURED, S.FAULT, S.STOPPED]
    robots["alerts"] = [Alert.SILENT, Alert.STALLED, 0, 0, Alert.STALLED, Alert.REBOOTED]
    cut_off = np.array([True, True, False, False, False, False])
    assert own_fault(robots, cut_off).tolist() == [
        Reason.OK, Reason.BUS_FAILED, Reason.NO_REPLY, Reason.REBOOTED, Reason.STALLED,
        Reason.REBOOTED,
    ]  # fmt: skip


@pytest.mark.parametrize("verify_s", [0.0, 0.01, 0.1, 0.4])
def test_in_a_countdown_all_robots_can_be_polled_and_one_polled_again(verify_s):
    lasts_s = countdown_s(verify_s, SILENCE_S, PERIOD_S)
    # the last heartbeats before the motion, and the time of another poll or another GO
    spare_s = lasts_s - verify_s - SILENCE_S - 2 * PERIOD_S
    assert 0.2 * verify_s + 10e-3 <= spare_s + 1e-12 and spare_s <= 0.2 * verify_s + 11e-3
    assert countdown_s(9.0, SILENCE_S, PERIOD_S) == 0.65
    assert 0.65 / COUNTDOWN_S <= 2**16 - 1


def watched(robots, buses, go_s=1.0):
    robots, buses = new_robots(np.zeros((robots, 2), dtype=int)), new_buses(buses)
    robots["verified"] = True
    begin_watch(robots, buses, go_s)
    return robots, buses


def test_after_a_cancelled_start_robots_without_stop_confirmation_or_heartbeat_are_missing():
    robots, buses = watched(6, 3)
    bus = np.array([0, 0, 1, 1, 2, 2])
    buses["heartbeat_s"] = [1.02, 1.02 - 2.1 * PERIOD_S, 1.02 - 1.9 * PERIOD_S]
    everyone = np.ones(6, dtype=bool)
    rows = np.array([0, 1, 2, 4, 5])  # robot 3 was sent no GO

    def missing(stopped=everyone, responding=everyone):
        return np.flatnonzero(
            unresponsive(robots, buses, bus, rows, stopped, responding, PERIOD_S)
        ).tolist()

    assert missing() == [2]
    but_0, but_5 = np.arange(6) != 0, np.arange(6) != 5
    assert missing(stopped=but_0) == [0, 2]
    assert missing(responding=but_5) == [2, 5]
    assert missing(but_0, but_5) == [0, 2, 5]


def test_a_robot_fails_at_its_sixth_missed_reply_or_when_it_does_not_execute():
    robots, _ = watched(4, 1)
    robots["missed_replies"] = [0, 5, 6, 7]
    assert failing(robots).tolist() == [False, False, True, True]
    robots["not_executing"][0] = True
    assert failing(robots).tolist() == [True, False, True, True]


def test_the_stop_for_a_silent_robot_is_half_way_between_its_two_possible_stops():
    _, buses = watched(2, 2)
    buses["called_before_s"], buses["called_s"] = [1.0, 2.0], [1.0025, 2.004]
    stops = silent_stop_s(buses, np.array([1, 0]), SILENCE_S)
    first, last = np.array([2.0, 1.0]), np.array([2.004, 1.0025]) + SILENCE_S
    np.testing.assert_allclose(stops - first, last - stops, atol=1e-12)


STATES = {
    # state and alerts of a robot after a stop, and whether it may resume
    "stopped": (RobotState.STOPPED, 0, True),
    "arrived before": (RobotState.DONE, 0, False),
    "still moving": (RobotState.MOVING, 0, False),
    "no reply": (0, 0, False),
    "stopped, stalled": (RobotState.STOPPED, Alert.STALLED, False),
    "stopped, booted": (RobotState.STOPPED, Alert.REBOOTED, False),
    "fault": (RobotState.FAULT, 0, False),
    "fault of a stall": (RobotState.FAULT, Alert.STALLED, False),
    "silent": (RobotState.FAULT, Alert.SILENT, True),
    "silent and stalled": (RobotState.FAULT, Alert.SILENT | Alert.STALLED, False),
    "silent and booted": (RobotState.FAULT, Alert.SILENT | Alert.REBOOTED, False),
}


@pytest.mark.parametrize("case", STATES)
def test_a_robot_that_stopped_in_order_may_resume(case):
    state, alerts, able = STATES[case]
    robots, _ = watched(3, 2)
    robots["state"], robots["alerts"] = state, alerts
    bus, moved = np.array([0, 0, 1]), np.ones(3, dtype=bool)
    assert able_to_resume(robots, bus, moved).tolist() == [able] * 3
    robots["lost"][1] = True
    assert able_to_resume(robots, bus, moved).tolist() == [able, False, able]


def test_a_silent_robot_on_a_bus_with_heartbeats_may_not_resume():
    robots, _ = watched(5, 2)
    silent, stopped = RobotState.FAULT, RobotState.STOPPED
    robots["state"] = [stopped, silent, silent, silent, stopped]
    robots["alerts"] = np.where(robots["state"] == silent, Alert.SILENT, 0)
    bus = np.array([0, 0, 1, 1, 1])
    moved = np.array([True, True, True, True, False])
    # robot 4 was not moving: that it is stopped says nothing about heartbeats
    assert able_to_resume(robots, bus, moved).tolist() == [True, False, True, True, True]


def beats(buses, at, end_s, took_s, ack=Ack.OK):
    at = np.asarray(at)
    record_heartbeats(
        buses, at, np.full(len(at), int(ack)), np.full(len(at), end_s),
        np.full(len(at), took_s), SILENCE_S, STRETCH_S,
    )  # fmt: skip


def test_a_heartbeat_counts_only_while_its_robots_still_listen_to_it():
    _, buses = watched(1, 2, go_s=1.0)
    beats(buses, [0, 1], 1.004, 60e-6)
    assert buses["heartbeat_s"].tolist() == [1.004, 1.004]
    beats(buses, [0], 1.007, 60e-6, Ack.NO_ADDRESS)
    assert buses["heartbeat_s"].tolist() == [1.004, 1.004]
    beats(buses, [1], 1.008, 60e-6)
    beats(buses, [0, 1], 1.0095, 60e-6)  # too late for the robots of bus 0
    assert buses["heartbeat_s"].tolist() == [1.004, 1.0095]
    assert buses["slow"].tolist() == [0, 0]


@pytest.mark.parametrize("took_s, slow", [(1.05e-3, 0), (1.07e-3, 1), (5e-3, 1)])
def test_a_heartbeat_is_slow_by_the_shortest_of_its_bus_and_slow_ones_are_counted_in_a_row(
    took_s, slow
):
    _, buses = watched(1, 2)
    beats(buses, [0], 1.001, 80e-6)
    beats(buses, [0], 1.002, 60e-6)
    beats(buses, [0], 1.003, 70e-6)
    assert buses["slow"].tolist() == [0, 0]
    for k in range(1, 4):
        beats(buses, [0], 1.003 + 1e-3 * k, took_s)
        assert buses["slow"].tolist() == [slow * k, 0]
    beats(buses, [0], 1.007, 70e-6)
    assert buses["slow"][0] == 0
    assert buses["shortest_s"].tolist() == [60e-6, np.inf]
