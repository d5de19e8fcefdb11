"""Replanning of a plan add up, and the roster knows who is left out of the next."""

import numpy as np
import pytest

from fiber_bus_bridge import Availability, BridgeError, PlanResult, Replanning
from fiber_bus_bridge.disabled_list import read_disabled, write_disabled
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset

REACHED = (Outcome.REACHED, Reason.OK)
ABSENT = (Outcome.HELD, Reason.NOT_ACKNOWLEDGED)
UNSAFE = (Outcome.HELD, Reason.UNSAFE_AS_LOADED)
STALLED = (Outcome.FAILED, Reason.NOT_ACKNOWLEDGED)
UNASKED = (Outcome.HELD, Reason.NO_TARGET)
BLOCKED = (Outcome.HELD, Reason.GOAL_BLOCKED)
HALTED = (Outcome.HELD, Reason.STOPPED)


def result_of(*pairs):
    outcome, reason = np.array(pairs).T
    return PlanResult(outcome, reason, np.arange(len(pairs), dtype=float))


def attempts(*pairs, most=2, asked=None):
    """Replanning whose first attempt ended as the pairs say; asked: all but NO_TARGET."""
    goals = np.zeros((len(pairs), 2))
    goals[[pair == UNASKED for pair in pairs]] = np.nan
    made = Replanning(goals, most)
    made.add(result_of(*pairs), made.asked if asked is None else asked)
    return made


ALL = np.ones(4, dtype=bool)
BUT_FIRST = np.array([False, True, True, True])


@pytest.mark.parametrize("waits", [UNSAFE, HALTED])
@pytest.mark.parametrize("lost", [ABSENT, STALLED])
def test_others_held_for_one_that_is_lost_are_asked_again_with_all_that_have_arrived(waits, lost):
    again = attempts(lost, waits, REACHED, UNASKED).again(ALL, BUT_FIRST)
    assert again.tolist() == [False, True, True, False]


@pytest.mark.parametrize(
    ("pairs", "ordered", "commandable"),
    [
        ((REACHED, REACHED, REACHED, REACHED), ALL, ALL),
        ((ABSENT, REACHED, REACHED, UNASKED), ALL, BUT_FIRST),  # nobody waits
        ((UNSAFE, UNSAFE, REACHED, REACHED), ALL, ALL),  # nothing is known that was not
        ((ABSENT, UNSAFE, REACHED, REACHED), BUT_FIRST, BUT_FIRST),  # it was known before
        ((ABSENT, BLOCKED, REACHED, REACHED), ALL, BUT_FIRST),  # not held for it
        ((ABSENT, UNSAFE, REACHED, REACHED), ALL, ALL & False),  # cannot be commanded either
    ],
)
def test_nobody_is_asked_again_without_need(pairs, ordered, commandable):
    assert not attempts(*pairs).again(ordered, commandable).any()


def test_there_are_no_more_attempts_than_allowed():
    assert not attempts(ABSENT, UNSAFE, REACHED, UNASKED, most=1).again(ALL, BUT_FIRST).any()
    two = attempts(ABSENT, UNSAFE, REACHED, UNASKED, most=2)
    two.add(result_of(UNASKED, ABSENT, UNSAFE, UNASKED), np.array([False, True, True, False]))
    assert not two.again(BUT_FIRST, np.array([False, False, True, True])).any()


def test_the_last_attempt_a_robot_is_asked_in_counts_and_a_failure_always():
    both = attempts(ABSENT, UNSAFE, REACHED, UNASKED)
    second = result_of(UNASKED, REACHED, HALTED, STALLED)
    both.add(second, np.array([False, True, True, False]))
    ended = both.result
    assert list(zip(ended.outcome, ended.reason)) == [ABSENT, REACHED, HALTED, STALLED]
    assert ended.error_mm.tolist() == [0.0, 1.0, 2.0, 3.0]


PLANE = preset("desi", 7).with_enabled(np.arange(7) != 6)


def test_who_is_out_for_which_reason(tmp_path):
    roster = Availability(PLANE)
    known = np.arange(7) != 5
    roster.disable([2], "arm bent")
    failed = result_of(ABSENT, STALLED, UNASKED, UNSAFE, REACHED, ABSENT, UNASKED)
    roster.leave_out(failed, known)
    assert np.flatnonzero(roster.enabled).tolist() == [0, 1, 3, 4, 5]
    assert np.flatnonzero(roster.commandable(known)).tolist() == [3, 4]
    told = roster.explain(result_of(*[(Outcome.HELD, Reason.DISABLED)] * 7))
    assert told.reason[:3].tolist() == [Reason.NOT_ACKNOWLEDGED] * 2 + [Reason.DISABLED]
    roster.take_back()
    assert np.flatnonzero(roster.commandable(known)).tolist() == [0, 1, 3, 4]


def test_the_list_outlives_whoever_keeps_it_and_reasons_stay(tmp_path):
    path = tmp_path / "night" / "disabled.yaml"
    roster = Availability(PLANE, path)
    roster.disable([3], "arm bent: see log of 2026-11-20")
    roster.disable([3, 1], "fibre broken")
    assert Availability(PLANE, path).disabled == {
        3: "arm bent: see log of 2026-11-20",
        1: "fibre broken",
    }
    roster.disable([1])
    assert read_disabled(path) == {1: "fibre broken"}
    roster.disable([])
    assert Availability(PLANE, path).disabled == {} and roster.enabled[:6].all()
    assert [entry.name for entry in path.parent.iterdir()] == ["disabled.yaml"]


def test_a_robot_the_plane_does_not_have_is_refused_and_the_list_stays(tmp_path):
    path = tmp_path / "disabled.yaml"
    roster = Availability(PLANE, path)
    roster.disable([1], "x")
    with pytest.raises(BridgeError, match="robot 99: no such robot"):
        roster.disable([1, 99])
    assert read_disabled(path) == roster.disabled == {1: "x"}
    write_disabled(path, {99: ""})
    with pytest.raises(BridgeError, match="robot 99: no such robot"):
        Availability(PLANE, path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("3: [", "disabled.yaml: while parsing"),
        ("- 3\n- 17\n", "no table of ids"),
        ("three: bent\n", "'three': 'bent', expected an id"),
        ("true: bent\n", "True: 'bent', expected an id"),
        ("3: 7\n", "3: 7, expected an id and a reason"),
        ("\x00", "disabled.yaml"),
    ],
)
def test_a_file_that_is_no_list_is_an_error_and_not_an_empty_list(tmp_path, text, said):
    path = tmp_path / "disabled.yaml"
    path.write_text(text)
    with pytest.raises(BridgeError, match=said):
        read_disabled(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(BridgeError, match=r"disabled\.yaml"):
        read_disabled(path)


def test_a_list_that_cannot_be_written_changes_nothing(tmp_path):
    path = tmp_path / "disabled.yaml"
    roster = Availability(PLANE, path)
    path.mkdir()  # root may write anywhere, but not in the place of a folder
    (path / "full").touch()
    with pytest.raises(BridgeError, match=r"disabled\.yaml"):
        roster.disable([3])
    assert not roster.disabled and roster.enabled[3]


def test_a_file_edited_by_hand_may_be_empty(tmp_path):
    path = tmp_path / "disabled.yaml"
    assert read_disabled(path) == {}
    path.write_text("# nobody\n")
    assert read_disabled(path) == {}
