# SPDX-License-Identifier: Apache-2.0
"""Decisions of the protocol, as functions of the tables.

Equivalent mutant, left alive: the comparison of boot counters in `stopping.stop`. A robot that
booted is UNCONFIGURED and stays so when it is told to stop, so `able_to_resume` excludes it.
"""

import numpy as np
import pytest

from fiber_bus_bridge.bus import Ack
from fiber_bus_bridge.protocol.decisions import (
    able_to_resume,
    failing,
    neighbours_of,
    record_heartbeats,
    silent_stop_s,
    unresponsive,
)
from fiber_bus_bridge.protocol.tables import new_buses, new_robots
from fiber_bus_bridge.wire import Alert, RobotState

BUS = np.array([0, 0, 1, 1])
ALL = np.ones(4, dtype=bool)


def robots_in(state, alerts=0, **columns):
    robots = new_robots(np.zeros((4, 2), dtype=np.int64))
    robots["state"], robots["alerts"] = state, alerts
    for name, value in columns.items():
        robots[name] = value
    return robots


@pytest.mark.parametrize(
    ("state", "alerts", "lost", "able"),
    [
        (RobotState.STOPPED, 0, False, True),
        (RobotState.STOPPED, Alert.REFUSED, False, True),
        (RobotState.STOPPED, Alert.STALLED, False, False),
        (RobotState.STOPPED, Alert.REBOOTED, False, False),
        # a robot without an answer has state 0: `lost` is a second barrier
        (RobotState.STOPPED, 0, True, False),
        (0, 0, True, False),
        (RobotState.MOVING, 0, True, False),
        (RobotState.FAULT, Alert.SILENT, False, True),
        (RobotState.FAULT, 0, False, False),
        (RobotState.UNCONFIGURED, 0, False, False),
    ],
)
def test_a_robot_may_resume_that_has_stopped_in_order(state, alerts, lost, able):
    robots = robots_in(state, alerts, lost=lost)
    assert able_to_resume(robots, BUS, ALL).tolist() == [able] * 4


def test_a_robot_that_misses_the_heartbeats_of_its_bus_does_not_resume():
    stopped, silent = RobotState.STOPPED, RobotState.FAULT
    robots = robots_in([stopped, silent, silent, silent], Alert.SILENT)
    assert able_to_resume(robots, BUS, ALL).tolist() == [True, False, True, True]
    # a robot that did not move says nothing about heartbeats
    assert able_to_resume(robots, BUS, ~ALL).tolist() == [True] * 4


def test_a_start_is_cancelled_because_of_robots_and_buses_that_do_not_take_part():
    robots, buses = robots_in(RobotState.STOPPED), new_buses(2)
    buses["heartbeat_s"] = 1.0
    rows = np.array([0, 1, 3])

    def missing(stopped=ALL, responding=ALL):
        return unresponsive(robots, buses, BUS, rows, stopped, responding, 2.5e-3).tolist()

    assert missing() == [False] * 4
    assert missing(stopped=np.arange(4) != 1) == [False, True, False, False]
    assert missing(responding=np.arange(4) != 3) == [False, False, False, True]
    assert missing(stopped=np.arange(4) != 2) == [False] * 4  # was not sent the GO
    buses["heartbeat_s"][1] -= 4.9e-3
    assert missing() == [False] * 4
    buses["heartbeat_s"][1] -= 0.2e-3
    assert missing() == [False, False, False, True]


def test_neighbours_of_a_lost_robot_are_those_in_a_pair_with_it():
    pairs = np.array([[0, 1], [1, 2], [2, 7]])  # row 7 is an obstacle
    lost = np.array([True, False, False, False])
    assert neighbours_of(lost, pairs).tolist() == [False, True, False, False]
    assert neighbours_of(lost[[1, 1, 0, 1]], pairs).tolist() == [False, True, False, False]


def test_a_robot_fails_that_does_not_execute_or_misses_six_replies():
    robots = robots_in(RobotState.MOVING, missed_replies=[0, 5, 6, 0])
    robots["not_executing"][3] = True
    assert failing(robots).tolist() == [False, False, True, True]


def test_all_stop_half_way_between_the_first_and_the_last_stop_of_a_silent_robot():
    buses = new_buses(2)
    buses["called_before_s"], buses["called_s"] = [1.0, 2.0], [1.0025, 2.0025]
    assert silent_stop_s(buses, np.array([1]), 5e-3) == pytest.approx([2.00375])


def heartbeats(buses, at_s, took_s, ack=Ack.OK, stretch_s=1e-3):
    at_s = np.atleast_1d(at_s)
    record_heartbeats(
        buses, np.zeros(len(at_s), dtype=np.int64), np.full(len(at_s), int(ack)),
        at_s, np.full(len(at_s), took_s), 5e-3, stretch_s,
    )  # fmt: skip


def test_slow_heartbeats_in_a_row_are_counted():
    buses = new_buses(1)
    buses["shortest_s"], buses["heartbeat_s"] = np.inf, 1.0
    heartbeats(buses, 1.001, 30e-6)
    assert (buses["slow"][0], buses["shortest_s"][0]) == (0, 30e-6)
    heartbeats(buses, 1.002, 1.02e-3)  # not longer than the shortest by more than 1 ms
    assert buses["slow"][0] == 0
    heartbeats(buses, [1.003, 1.004], 1.04e-3)
    assert buses["slow"][0] == 2
    heartbeats(buses, 1.005, 30e-6)
    assert buses["slow"][0] == 0 and buses["heartbeat_s"][0] == 1.005


def test_a_heartbeat_that_failed_or_came_too_late_does_not_count():
    buses = new_buses(1)
    buses["shortest_s"], buses["heartbeat_s"] = np.inf, 1.0
    heartbeats(buses, 1.001, 30e-6, Ack.REFUSED)
    heartbeats(buses, 1.0051, 30e-6)  # its robots have stopped by themselves
    assert buses["heartbeat_s"][0] == 1.0 and np.isinf(buses["shortest_s"][0])
