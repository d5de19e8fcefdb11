"""Polls: all robots in turn, and presence tests of all robots in each step where time suffices."""

import numpy as np
import pytest

from fiber_bus_bridge.poll_scheduler import PollScheduler

READ_S, TEST_S, BUDGET_S = 200e-6, 20e-6, 2.25e-3


def scheduler_after_a_step(bus):
    scheduler = PollScheduler(bus, int(bus.max()) + 1, BUDGET_S, READ_S)
    all_robots = np.ones(len(bus), dtype=bool)
    read, tested = scheduler.next(all_robots, True)
    scheduler.observe(read, np.full(len(read), READ_S), tested, np.full(len(tested), TEST_S))
    return scheduler, all_robots


def test_the_first_step_reads_one_robot_and_tests_none():
    scheduler = PollScheduler(np.zeros(40, dtype=int), 1, BUDGET_S)
    read, tested = scheduler.next(np.ones(40, dtype=bool), True)
    assert read.tolist() == [0] and tested.tolist() == []


@pytest.mark.parametrize("robots", [1, 16, 30])
def test_all_robots_are_tested_in_each_step_where_half_the_budget_suffices(robots):
    scheduler, all_robots = scheduler_after_a_step(np.repeat([0, 1], robots))
    read, tested = scheduler.next(all_robots, True)
    assert sorted(tested) == list(range(2 * robots))
    reads = (read < robots).sum()
    assert reads >= 1 and reads * READ_S + robots * TEST_S <= 0.5 * BUDGET_S + READ_S


def test_a_larger_bus_uses_its_whole_budget_and_tests_all_robots_in_turn():
    scheduler, all_robots = scheduler_after_a_step(np.zeros(500, dtype=int))
    covered, steps = np.zeros(500, dtype=bool), 0
    while not covered.all():
        read, tested = scheduler.next(all_robots, True)
        assert len(read) * READ_S + len(tested) * TEST_S <= BUDGET_S
        scheduler.observe(read, np.full(len(read), READ_S), tested, np.full(len(tested), TEST_S))
        covered[tested] = True
        steps += 1
    assert steps == pytest.approx(500 / (0.3 * BUDGET_S / TEST_S), abs=2)


def test_a_robot_that_is_left_out_is_not_polled():
    scheduler, all_robots = scheduler_after_a_step(np.arange(60) % 3)
    all_robots[::2] = False
    seen = np.concatenate([np.concatenate(scheduler.next(all_robots, True)) for _ in range(20)])
    assert np.array_equal(np.unique(seen), np.flatnonzero(all_robots))
    assert scheduler.next(np.zeros(60, dtype=bool), True)[0].size == 0
