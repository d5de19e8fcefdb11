# SPDX-License-Identifier: Apache-2.0
"""Attempts of plans: their stamps, their numbers, and the table that finds the plan of a stamp."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_msgs_py import Attempt, AttemptTable, MessageError, PlanStamp

FIRST = Attempt.first(PlanStamp(100))
SECOND = FIRST.next(PlanStamp(101), since_ns=7)
THIRD = SECOND.next(PlanStamp(105))
OTHER = Attempt.first(PlanStamp(200))


def test_a_later_attempt_keeps_the_plan_and_has_a_later_stamp_of_its_own():
    assert (FIRST.stamp, FIRST.plan, FIRST.number, FIRST.since_ns) == (
        PlanStamp(100), PlanStamp(100), 1, None,
    )  # fmt: skip
    assert (SECOND.plan, SECOND.number, SECOND.since_ns) == (FIRST.plan, 2, 7)
    assert (THIRD.plan, THIRD.number, THIRD.since_ns) == (FIRST.plan, 3, None)
    assert FIRST.stamp < SECOND.stamp < THIRD.stamp < OTHER.stamp
    assert str(FIRST) == str(FIRST.plan) and str(THIRD) == f"{FIRST.plan} attempt 3"


@given(st.integers(0, 20), st.integers(0, 20), st.integers(-2, 5))
def test_only_the_first_attempt_has_the_stamp_of_its_plan(stamp_ns, plan_ns, number):
    good = number >= 1 and (stamp_ns == plan_ns if number == 1 else stamp_ns > plan_ns)
    if good:
        Attempt(PlanStamp(stamp_ns), PlanStamp(plan_ns), number)
    else:
        with pytest.raises(MessageError, match="attempt: "):
            Attempt(PlanStamp(stamp_ns), PlanStamp(plan_ns), number)


@pytest.mark.parametrize("order", list(itertools.permutations([FIRST, SECOND, THIRD, OTHER])))
def test_the_table_finds_the_plan_of_a_stamp_in_whatever_order_attempts_are_announced(order):
    table = AttemptTable()
    assert all(table.add(attempt) for attempt in order)
    assert not any(table.add(attempt) for attempt in order)
    assert table.find(SECOND.stamp) == SECOND and table.find(PlanStamp(102)) is None
    assert table.of_plan(FIRST.plan) == [FIRST, SECOND, THIRD]
    assert table.of_plan(OTHER.plan) == [OTHER]


def test_a_plan_has_its_first_attempt_though_only_a_later_one_was_announced():
    table = AttemptTable()
    table.add(SECOND)
    assert table.of_plan(FIRST.plan) == [FIRST, SECOND]


def test_the_table_forgets_the_oldest():
    table = AttemptTable()
    for ns in range(100):
        table.add(Attempt.first(PlanStamp(ns)))
    assert table.find(PlanStamp(0)) is None and table.find(PlanStamp(99)) is not None
