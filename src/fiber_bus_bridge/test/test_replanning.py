# SPDX-License-Identifier: Apache-2.0
"""The attempts of a plan are combined, and failed or disabled robots are left out of plans."""

import numpy as np
import pytest

from fiber_bus_bridge import Availability, BridgeError, PlanResult, Replanning
from fiber_bus_bridge.disabled_list import read_disabled, write_disabled
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset

REACHED = (Outcome.REACHED, Reason.OK)
ABSENT = (Outcome.HELD, Reason.NOT_ACKNOWLEDGED)
UNSAFE = (Outcome.HELD, Reason.UNSAFE_AS_LOADED)
STALLED = (Outcome.FAILED, Reason.STALLED)
UNASKED = (Outcome.HELD, Reason.NO_TARGET)
BLOCKED = (Outcome.HELD, Reason.GOAL_BLOCKED)
HALTED = (Outcome.HELD, Reason.STOPPED)
BYSTANDER = (Outcome.HELD, Reason.OTHER_FAILED)
BESIDE = (Outcome.HELD, Reason.PLACE_UNKNOWN)


def result_of(*pairs):
    outcome, reason = np.array(pairs).T
    return PlanResult(outcome, reason, np.arange(len(pairs), dtype=float))


def attempts(*pairs, max_attempts=2, asked=None):
    """Replanning after a first attempt with these results; asked: all but NO_TARGET."""
    goals = np.zeros((len(pairs), 2))
    goals[[pair == UNASKED for pair in pairs]] = np.nan
    replanning = Replanning(goals, max_attempts)
    replanning.add_attempt(result_of(*pairs), replanning.asked if asked is None else asked)
    return replanning


ALL = np.ones(4, dtype=bool)
BUT_FIRST = np.array([False, True, True, True])


@pytest.mark.parametrize("waits", [UNSAFE, HALTED, BYSTANDER, BESIDE])
@pytest.mark.parametrize("lost", [ABSENT, STALLED])
def test_robots_held_because_of_a_lost_one_are_asked_again_with_all_that_have_arrived(waits, lost):
    robots = attempts(lost, waits, REACHED, UNASKED).next_robots(ALL, BUT_FIRST)
    assert robots.tolist() == [False, True, True, False]


@pytest.mark.parametrize(
    ("pairs", "ordered", "commandable"),
    [
        ((REACHED, REACHED, REACHED, REACHED), ALL, ALL),
        ((ABSENT, REACHED, REACHED, UNASKED), ALL, BUT_FIRST),  # no robot waits
        ((UNSAFE, UNSAFE, REACHED, REACHED), ALL, ALL),  # no new obstacle
        ((ABSENT, UNSAFE, REACHED, REACHED), BUT_FIRST, BUT_FIRST),  # the planner knew the obstacle
        ((ABSENT, BLOCKED, REACHED, REACHED), ALL, BUT_FIRST),  # held for another reason
        (
            (ABSENT, UNSAFE, REACHED, REACHED),
            ALL,
            ALL & False,
        ),  # neither can be commanded
    ],
)
def test_no_robot_is_asked_again_without_need(pairs, ordered, commandable):
    assert not attempts(*pairs).next_robots(ordered, commandable).any()


def test_there_are_no_more_attempts_than_allowed():
    assert (
        not attempts(ABSENT, UNSAFE, REACHED, UNASKED, max_attempts=1)
        .next_robots(ALL, BUT_FIRST)
        .any()
    )
    two = attempts(ABSENT, UNSAFE, REACHED, UNASKED, max_attempts=2)
    two.add_attempt(
        result_of(UNASKED, ABSENT, UNSAFE, UNASKED), np.array([False, True, True, False])
    )
    assert not two.next_robots(BUT_FIRST, np.array([False, False, True, True])).any()


def test_the_last_attempt_a_robot_is_asked_in_counts_and_a_failure_always():
    both = attempts(ABSENT, UNSAFE, REACHED, UNASKED)
    second = result_of(UNASKED, REACHED, HALTED, STALLED)
    both.add_attempt(second, np.array([False, True, True, False]))
    ended = both.result
    assert list(zip(ended.outcome, ended.reason)) == [ABSENT, REACHED, HALTED, STALLED]
    assert ended.error_mm.tolist() == [0.0, 1.0, 2.0, 3.0]


PLANE = preset("desi", 7).with_enabled(np.arange(7) != 6)


def test_each_excluded_robot_has_its_reason(tmp_path):
    availability = Availability(PLANE)
    known = np.arange(7) != 5
    availability.disable([2], "arm bent")
    failed = result_of(ABSENT, STALLED, UNASKED, UNSAFE, REACHED, ABSENT, UNASKED)
    availability.exclude_failed(failed, known)
    assert np.flatnonzero(availability.enabled).tolist() == [0, 1, 3, 4, 5]
    assert np.flatnonzero(availability.commandable(known)).tolist() == [3, 4]
    explained = availability.explain(result_of(*[(Outcome.HELD, Reason.DISABLED)] * 7))
    expected = [Reason.NOT_ACKNOWLEDGED, Reason.STALLED, Reason.DISABLED]
    assert explained.reason[:3].tolist() == expected
    availability.restore()
    assert np.flatnonzero(availability.commandable(known)).tolist() == [0, 1, 3, 4]


def test_the_list_outlives_the_bridge_and_keeps_the_reasons(tmp_path):
    path = tmp_path / "night" / "disabled.yaml"
    availability = Availability(PLANE, path)
    availability.disable([3], "arm bent: see log of 2026-11-20")
    availability.disable([3, 1], "fibre broken")
    assert Availability(PLANE, path).disabled == {
        3: "arm bent: see log of 2026-11-20",
        1: "fibre broken",
    }
    availability.disable([1])
    assert read_disabled(path) == {1: "fibre broken"}
    availability.disable([])
    assert Availability(PLANE, path).disabled == {} and availability.enabled[:6].all()
    assert [entry.name for entry in path.parent.iterdir()] == ["disabled.yaml"]


def test_a_robot_the_plane_does_not_have_is_refused_and_the_list_stays(tmp_path):
    path = tmp_path / "disabled.yaml"
    availability = Availability(PLANE, path)
    availability.disable([1], "x")
    with pytest.raises(BridgeError, match="robot 99 cannot be disabled: the plane has no"):
        availability.disable([1, 99])
    assert read_disabled(path) == availability.disabled == {1: "x"}
    write_disabled(path, {99: ""})
    with pytest.raises(BridgeError, match="robot 99 cannot be disabled: the plane has no"):
        Availability(PLANE, path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("3: [", "disabled.yaml: while parsing"),
        ("- 3\n- 17\n", "is not a table of ids"),
        ("three: bent\n", "'three': 'bent', expected an id"),
        ("true: bent\n", "True: 'bent', expected an id"),
        ("3: 7\n", "3: 7, expected an id and a reason"),
        ("\x00", "disabled.yaml"),
    ],
)
def test_a_file_without_a_list_is_an_error_and_not_an_empty_list(tmp_path, text, message):
    path = tmp_path / "disabled.yaml"
    path.write_text(text)
    with pytest.raises(BridgeError, match=message):
        read_disabled(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(BridgeError, match=r"disabled\.yaml"):
        read_disabled(path)


def test_a_list_that_cannot_be_written_changes_nothing(tmp_path):
    path = tmp_path / "disabled.yaml"
    availability = Availability(PLANE, path)
    path.mkdir()  # even root cannot replace a folder by a file
    (path / "full").touch()
    with pytest.raises(BridgeError, match=r"disabled\.yaml"):
        availability.disable([3])
    assert not availability.disabled and availability.enabled[3]


def test_a_file_edited_by_hand_may_be_empty(tmp_path):
    path = tmp_path / "disabled.yaml"
    assert read_disabled(path) == {}
    path.write_text("# no robot\n")
    assert read_disabled(path) == {}
