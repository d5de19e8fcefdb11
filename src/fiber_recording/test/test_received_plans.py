# SPDX-License-Identifier: Apache-2.0
"""The recorder groups messages by attempt and plan, in whatever order they come."""

import itertools
from types import SimpleNamespace

import pytest

from fiber_msgs_py import Attempt, PlanStamp
from fiber_recording.received_plans import ReceivedPlans

PLAN = Attempt.first(PlanStamp(100))
SECOND = PLAN.next(PlanStamp(101))
NEXT_PLAN = Attempt.first(PlanStamp(200))


def steps(plans):
    """Functions that each receive one message of two plans."""
    return {
        "targets of the plan": lambda: plans.announce(PLAN),
        "frames of the plan": lambda: plans.attempt(PLAN.stamp).logs.append("first"),
        "targets of the second attempt": lambda: plans.announce(SECOND),
        "frames of the second attempt": lambda: plans.attempt(SECOND.stamp).logs.append("second"),
        "frames of the next plan": lambda: plans.attempt(NEXT_PLAN.stamp).logs.append("next"),
        "targets of the next plan": lambda: plans.announce(NEXT_PLAN),
    }


@pytest.mark.parametrize("order", list(itertools.permutations(range(6)))[::17])
def test_frames_are_grouped_by_plan_in_whatever_order_messages_come(order):
    plans = ReceivedPlans()
    receive = list(steps(plans).values())
    for step in order:
        receive[step]()
    assert plans.attempts(PLAN.plan).logs == ["first", "second"]
    assert plans.attempts(NEXT_PLAN.plan).logs == ["next"]
    assert len(plans.attempts(PLAN.plan).executed) == 2
    assert not plans.has_unannounced_frames(PLAN.plan)


def test_frames_without_an_announcement_keep_the_plan_before_them_open():
    plans = ReceivedPlans()
    receive = steps(plans)
    receive["targets of the plan"]()
    receive["frames of the second attempt"]()
    assert plans.attempts(PLAN.plan).logs == []
    assert plans.has_unannounced_frames(PLAN.plan)
    assert not plans.has_unannounced_frames(NEXT_PLAN.plan)
    receive["targets of the second attempt"]()
    assert not plans.has_unannounced_frames(PLAN.plan)


def test_a_plan_is_dropped_with_all_its_attempts():
    plans = ReceivedPlans()
    for receive in steps(plans).values():
        receive()
    plans.plan(PLAN.plan).outcome = SimpleNamespace()
    assert [stamp for stamp, _, _ in plans.ended()] == [PLAN.plan]
    plans.drop(PLAN.plan)
    assert not list(plans.ended()) and plans.attempts(PLAN.plan).logs == []
    assert plans.attempts(NEXT_PLAN.plan).logs == ["next"]


def test_plans_that_wait_for_their_recording_outlast_those_that_have_not_ended():
    plans = ReceivedPlans()
    for k in range(10):
        plans.plan(PlanStamp(100 + k)).outcome = SimpleNamespace() if k % 2 == 0 else None
    assert [stamp.ns for stamp, _, _ in plans.ended()] == [100, 102, 104, 106, 108]
    for k in range(10, 40):
        plans.plan(PlanStamp(100 + k)).outcome = SimpleNamespace()
    assert len(list(plans.ended())) == 16
