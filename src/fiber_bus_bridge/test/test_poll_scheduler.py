# SPDX-License-Identifier: Apache-2.0
"""Polls: robots in turn, within the time that the roll call leaves of half of each step."""

import numpy as np
import pytest

from fiber_bus_bridge.poll_scheduler import PollScheduler

READ_S, CALL_S, BUDGET_S = 200e-6, 600e-6, 2.25e-3


def scheduler_after_a_step(bus):
    buses = int(bus.max()) + 1
    scheduler = PollScheduler(bus, buses, BUDGET_S, READ_S)
    all_robots = np.ones(len(bus), dtype=bool)
    read = scheduler.next(all_robots, True)
    scheduler.observe(read, np.full(len(read), READ_S), np.arange(buses), np.full(buses, CALL_S))
    return scheduler, all_robots


def test_the_first_step_reads_one_robot_of_each_bus_where_the_time_of_a_read_is_unknown():
    scheduler = PollScheduler(np.repeat([0, 1], 20), 2, BUDGET_S)
    assert scheduler.next(np.ones(40, dtype=bool), True).tolist() == [0, 20]


@pytest.mark.parametrize("robots", [1, 16, 500])
def test_call_and_reads_take_half_of_a_step_and_reads_alone_take_all_of_it(robots):
    scheduler, all_robots = scheduler_after_a_step(np.zeros(robots, dtype=int))
    called = scheduler.next(all_robots, True)
    assert 1 <= len(called) and CALL_S + len(called) * READ_S <= 0.5 * BUDGET_S + 1e-9
    alone = scheduler.next(all_robots, False)
    assert len(alone) == min(robots, int(BUDGET_S / READ_S))


def test_a_call_that_takes_all_the_time_leaves_one_read():
    scheduler, all_robots = scheduler_after_a_step(np.zeros(50, dtype=int))
    scheduler.observe(np.array([0]), np.array([READ_S]), np.array([0]), np.array([BUDGET_S]))
    assert len(scheduler.next(all_robots, True)) == 1


def test_all_robots_of_a_large_bus_are_read_in_turn():
    scheduler, all_robots = scheduler_after_a_step(np.zeros(500, dtype=int))
    rows = np.concatenate([scheduler.next(all_robots, False) for _ in range(100)])
    assert len(rows) >= 1000
    first = rows[0]
    np.testing.assert_array_equal(rows, (first + np.arange(len(rows))) % 500)


def test_a_robot_that_is_left_out_is_not_read():
    scheduler, all_robots = scheduler_after_a_step(np.arange(60) % 3)
    all_robots[::2] = False
    seen = np.concatenate([scheduler.next(all_robots, True) for _ in range(60)])
    assert np.array_equal(np.unique(seen), np.flatnonzero(all_robots))
    assert scheduler.next(np.zeros(60, dtype=bool), True).size == 0


def test_the_longest_read_of_the_last_step_counts_for_its_bus():
    bus = np.repeat([0, 1], 50)
    scheduler, all_robots = scheduler_after_a_step(bus)

    def reads_after(*took_s):
        rows = np.array([0, 1, 50, 51])
        scheduler.observe(rows, np.array(took_s), np.arange(0), np.zeros(0))
        return np.bincount(bus[scheduler.next(all_robots, False)], minlength=2).tolist()

    assert reads_after(READ_S, 2 * READ_S, READ_S, READ_S / 2) == [5, 11]
    assert reads_after(READ_S, READ_S, 3 * READ_S, READ_S) == [11, 3]
    assert reads_after(READ_S / 2, READ_S / 2, READ_S, 9 * BUDGET_S) == [22, 1]
