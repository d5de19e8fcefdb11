# SPDX-License-Identifier: Apache-2.0
"""Reasons of several stages are combined, and a plan's outcome is read by robot id."""

import numpy as np
import pytest

from fiber_core import FiberError, Outcome, PlanOutcome, Reason, first_reason, holds


def test_the_first_stage_that_held_a_robot_gives_the_reason():
    assignment = [Reason.OK, Reason.UNREACHABLE, Reason.OK, Reason.NO_TARGET, Reason.NO_TARGET]
    planner = [Reason.OK, Reason.NO_TARGET, Reason.TANGLED, Reason.NO_TARGET, Reason.NO_TARGET]
    discretizer = [Reason.OK, Reason.OK, Reason.UNSAFE, Reason.UNSAFE, Reason.OK]
    assert first_reason(assignment, planner, discretizer).tolist() == [
        Reason.OK,
        Reason.UNREACHABLE,
        Reason.TANGLED,
        Reason.UNSAFE,
        Reason.OK,
    ]


def test_a_robot_that_no_stage_held_keeps_the_reason_of_the_last_stage():
    reasons = [Reason.OK, Reason.NO_TARGET]
    assert first_reason(reasons[::-1], reasons).tolist() == reasons


def test_combining_reasons_is_associative():
    rng = np.random.default_rng(0)
    one, two, three = rng.choice([int(reason) for reason in Reason], (3, 500))
    together = first_reason(one, two, three)
    assert np.array_equal(together, first_reason(first_reason(one, two), three))
    assert np.array_equal(together, first_reason(one, first_reason(two, three)))


def test_the_first_reason_is_a_copy():
    reason = np.array([Reason.OK])
    assert not np.shares_memory(first_reason(reason), reason)


def test_every_reason_but_ok_and_no_target_holds():
    assert [reason for reason in Reason if not holds(reason)] == [Reason.OK, Reason.NO_TARGET]


def test_stages_of_different_sizes_are_refused():
    with pytest.raises(FiberError, match=r"different shapes: \(2,\), \(3,\)"):
        first_reason([0, 0], [0, 0, 0])
    with pytest.raises(FiberError, match="at least one stage"):
        first_reason()


def plan_outcome() -> PlanOutcome:
    return PlanOutcome(
        stamp_ns=7,
        ids=np.array([9, 2, 5]),
        outcome=np.array([Outcome.REACHED, Outcome.HELD, Outcome.HELD]),
        reason=np.array([Reason.OK, Reason.UNSAFE, Reason.NO_TARGET]),
        error_mm=np.array([0.001, 2.5, np.nan]),
    )


def test_outcomes_of_some_robots_come_in_the_order_asked():
    found = plan_outcome().of([2, 9])
    assert found.stamp_ns == 7 and found.ids.tolist() == [2, 9]
    assert found.outcome.tolist() == [Outcome.HELD, Outcome.REACHED]
    assert found.reason.tolist() == [Reason.UNSAFE, Reason.OK]
    assert found.error_mm.tolist() == [2.5, 0.001]
    assert len(plan_outcome().of([]).ids) == 0


@pytest.mark.parametrize("unknown", [1, 3, 10])
def test_an_unknown_robot_has_no_outcome_and_is_named(unknown):
    with pytest.raises(FiberError, match=f"robot {unknown} has no outcome"):
        plan_outcome().of([9, unknown, 2])


def test_a_plan_without_robots_has_no_outcome_of_any():
    nothing = np.zeros(0, dtype=np.int64)
    empty = PlanOutcome(0, nothing, nothing, nothing, np.zeros(0))
    with pytest.raises(FiberError, match="robot 4 has no outcome"):
        empty.of([4])


def test_robots_are_counted_by_outcome():
    assert [plan_outcome().count(outcome) for outcome in Outcome] == [1, 2, 0]
