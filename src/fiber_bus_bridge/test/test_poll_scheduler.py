"""Whose turn it is: everybody's in order, and all are asked in every step where there is time."""

import numpy as np
import pytest

from fiber_bus_bridge.poll_scheduler import PollScheduler

READ_S, ASK_S, ROOM_S = 200e-6, 20e-6, 2.25e-3


def turns_after_a_step(bus):
    turns = PollScheduler(bus, int(bus.max()) + 1, ROOM_S, READ_S)
    everybody = np.ones(len(bus), dtype=bool)
    read, asked = turns.next(everybody, True)
    turns.learn(read, np.full(len(read), READ_S), asked, np.full(len(asked), ASK_S))
    return turns, everybody


def test_nothing_is_known_before_the_first_step():
    turns = PollScheduler(np.zeros(40, dtype=int), 1, ROOM_S)
    read, asked = turns.next(np.ones(40, dtype=bool), True)
    assert read.tolist() == [0] and asked.tolist() == []


@pytest.mark.parametrize("robots", [1, 16, 30])
def test_all_are_asked_in_each_step_where_half_of_it_is_enough(robots):
    turns, everybody = turns_after_a_step(np.repeat([0, 1], robots))
    read, asked = turns.next(everybody, True)
    assert sorted(asked) == list(range(2 * robots))
    here = (read < robots).sum()
    assert here >= 1 and here * READ_S + robots * ASK_S <= 0.5 * ROOM_S + READ_S


def test_larger_buses_use_all_of_their_time_and_come_round():
    turns, everybody = turns_after_a_step(np.zeros(500, dtype=int))
    heard, steps = np.zeros(500, dtype=bool), 0
    while not heard.all():
        read, asked = turns.next(everybody, True)
        assert len(read) * READ_S + len(asked) * ASK_S <= ROOM_S
        turns.learn(read, np.full(len(read), READ_S), asked, np.full(len(asked), ASK_S))
        heard[asked] = True
        steps += 1
    assert steps == pytest.approx(500 / (0.3 * ROOM_S / ASK_S), abs=2)


def test_who_does_not_take_part_has_no_turn():
    turns, everybody = turns_after_a_step(np.arange(60) % 3)
    everybody[::2] = False
    seen = np.concatenate([np.concatenate(turns.next(everybody, True)) for _ in range(20)])
    assert np.array_equal(np.unique(seen), np.flatnonzero(everybody))
    assert turns.next(np.zeros(60, dtype=bool), True)[0].size == 0
