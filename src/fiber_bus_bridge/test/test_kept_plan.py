# SPDX-License-Identifier: Apache-2.0
"""What a bridge tells of the plan of one that died, and that it tells one thing only."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from session_rig import Rig

from fiber_bus_bridge import BridgeError, SessionConfig, SessionState
from fiber_bus_bridge.left_plan import LeftPlan, load_left_plan, save_left_plan
from fiber_bus_bridge.node.kept_plan import KeptPlan
from fiber_bus_bridge.plan_result import PlanResult
from fiber_bus_bridge.protocol import ending
from fiber_bus_bridge.simulation import Event
from fiber_core import kinematics
from fiber_core.outcomes import Outcome, Reason
from fiber_msgs_py import PlanStamp

N = 19
ALL = np.ones(N, dtype=bool)
WITHOUT_END = SessionConfig(silence_ms=0)  # robots carry out their orders without a controller

TWO_FAR = np.where(np.arange(N) < 2, 400, 0)


def left_by(rig, goals, ns=9):
    """A plan of which all robots were sent their GO."""
    nothing = np.full(N, int(Outcome.HELD)), np.full(N, int(Reason.NO_HEARTBEAT)), np.zeros(N)
    return LeftPlan(ns, goals, rig.plane.fibre, ALL, PlanResult(*nothing))


class Next:
    """The bridge after one that died: its session, and what it keeps and tells of the plan."""

    def __init__(self, rig, path):
        self.rig = Rig(robots=rig.robots, config=rig.session.config)
        self.rig.t = rig.t
        self.told, self.refused = [], []
        self.on_disk = []  # when an outcome was published
        outgoing = SimpleNamespace(publish_outcome=self._publish)
        reporter = SimpleNamespace(refuse=self.refused.append, info=lambda _: None)
        self._path = path.with_name("robots.plan")
        self.kept = KeptPlan(
            self.rig.session, rig.plane, path, outgoing, reporter, lambda: self.rig.t
        )

    def _publish(self, result, stamp):
        self.told.append((result, stamp))
        self.on_disk.append(load_left_plan(self._path, self.rig.plane))


@pytest.fixture
def path(tmp_path):
    return tmp_path / "robots"


def killed_in_motion(path, config=WITHOUT_END, theta=400, then_s=0.3):
    """A rig whose session is left in motion, with its plan in the file."""
    rig = Rig(config=config)
    motion = rig.ready(theta=theta)
    rig.call("start")
    rig.t = rig.session.loaded_plan.start_s + then_s
    ends = kinematics.forward(rig.plane, rig.units.to_angles(motion.end))[1]
    save_left_plan(path.with_name("robots.plan"), left_by(rig, ends), rig.plane)
    return rig


@pytest.mark.parametrize("why", [Reason.NO_REPLY, Reason.REBOOTED])
def test_a_robot_noted_at_its_target_that_then_does_not_answer_has_failed(why):
    rig = Rig()
    angles = rig.session.angles
    left = left_by(rig, kinematics.forward(rig.plane, angles)[1])
    cause = np.full(N, int(Reason.STOPPED))
    noted = left.noted(rig.plane, angles, ALL, cause, 0.1)
    assert (noted.result.outcome == Outcome.REACHED).all()
    cause[3], sure = why, np.arange(N) != 3
    for before in (left, noted):  # whether it was noted changes nothing
        result = before.found(rig.plane, angles, sure, cause, 0.1).result
        assert (result.outcome[3], result.reason[3]) == (Outcome.FAILED, why)
        assert (result.outcome[sure] == Outcome.REACHED).all()


def test_orders_that_come_while_robots_move_change_nothing_of_the_plan_before(path):
    rig = killed_in_motion(path, theta=TWO_FAR)
    rig.robots.power([5], False, rig.t)
    after = Next(rig, path)
    after.rig.call("configure")
    after.kept.tell()
    assert not after.told, "robots move still"
    after.rig.session.submit(after.rig.orders(0, 0))
    after.kept.begin(replace(left_by(rig, np.full((N, 2), np.nan)), stamp_ns=20))
    [(result, stamp)] = after.told
    assert stamp == PlanStamp(9)
    assert (result.outcome[5], result.reason[5]) == (Outcome.FAILED, Reason.NO_REPLY)


def test_what_is_found_of_a_plan_before_is_no_cause_of_orders_that_wait(path):
    rig = killed_in_motion(path, theta=TWO_FAR)
    after = Next(rig, path)
    rig.robots.schedule([(0, rig.t + 0.3, Event.JAM_THETA, 1)])
    after.rig.call("configure")
    after.rig.session.submit(after.rig.orders(0, 0))
    after.rig.t += 30.0
    after.kept.tell()
    [(result, _)] = after.told
    assert (result.outcome[0], result.reason[0]) == (Outcome.FAILED, Reason.STALLED)
    assert (after.rig.session.robots["cause"] == Reason.OK).all()


def test_a_robot_that_does_not_tell_why_it_rests_forgets_nothing(path, monkeypatch):
    rig = killed_in_motion(path, SessionConfig())
    after = Next(rig, path)
    rig.robots.schedule([(3, rig.t, Event.JAM_THETA, 1)])
    after.rig.t += 5.0
    transactions = after.rig.session.transactions
    statuses, readings = transactions.statuses, []

    def lost(rows, t):
        status = statuses(rows, t)
        readings.append(rows)
        heard = np.isin(rows, 3, invert=True) | (len(readings) > 1)
        each = status.select(np.arange(len(rows)))
        return replace(
            each, ok=each.ok & heard, **{
                name: np.where(heard, getattr(each, name), 0)
                for name in ("state", "sequence", "order_crc", "boot", "fault", "alerts")
            },
        )  # fmt: skip

    with monkeypatch.context() as patch:
        patch.setattr(transactions, "statuses", lost)
        after.rig.call("configure")
    assert not after.rig.session.known[3] and after.rig.robots.memory["fault"][3] != 0
    after.kept.tell()
    [(result, _)] = after.told
    assert (result.outcome[3], result.reason[3]) == (Outcome.FAILED, Reason.NO_REPLY)
    after.rig.call("configure")
    assert after.rig.session.known.all()


def test_an_outcome_that_cannot_be_kept_is_told_once_and_by_no_other_bridge(path, monkeypatch):
    rig = killed_in_motion(path, SessionConfig())
    rig.t += 5.0
    after = Next(rig, path)
    after.rig.call("configure")
    with monkeypatch.context() as patch:
        fill_disk(patch)
        after.kept.tell()
    assert len(after.told) == 1 and "no space left" in after.refused[0]
    assert after.on_disk == [None], "the next bridge cannot find another outcome"


def test_an_own_outcome_that_cannot_be_kept_is_told_by_no_other_bridge(path, monkeypatch):
    rig = Rig()
    after = Next(rig, path)
    plan = left_by(rig, np.full((N, 2), np.nan))
    after.kept.begin(plan)
    with monkeypatch.context() as patch:
        fill_disk(patch)
        after.kept.publish_outcome(plan.result, PlanStamp(9))
    assert after.told == [(plan.result, PlanStamp(9))] and after.on_disk == [None]
    after.kept.begin(plan)
    after.kept.publish_outcome(plan.result, PlanStamp(9))
    assert after.on_disk[1].ended, "it is kept until it is told"


def accept(kept, rig, ns=9):
    goals = np.where(np.arange(N)[:, None] < 5, rig.plane.centers + 3.0, np.nan)
    kept.accept(PlanStamp(ns), goals, rig.plane.fibre)


def test_a_plan_that_was_accepted_is_told_as_not_planned_by_the_next_bridge(path):
    rig = Rig()
    accept(Next(rig, path).kept, rig)
    after = Next(rig, path)
    after.rig.call("configure")
    after.kept.tell()
    [(result, stamp)] = after.told
    assert stamp == PlanStamp(9) and (result.outcome == Outcome.HELD).all()
    asked = np.arange(N) < 5
    assert (result.reason[asked] == Reason.NOT_PLANNED).all()
    assert (result.reason[~asked] == Reason.NO_TARGET).all()


def test_a_plan_that_its_bridge_has_ended_is_told_by_no_other(path):
    rig = Rig()
    before = Next(rig, path)
    accept(before.kept, rig)
    accept(before.kept, rig, ns=20)
    before.kept.publish_outcome(left_by(rig, np.full((N, 2), np.nan)).result, PlanStamp(20))
    after = Next(rig, path)
    after.rig.call("configure")
    after.kept.tell()
    assert len(before.told) == 1 and not after.told


def test_a_plan_that_is_accepted_takes_no_place_from_one_whose_robots_move_still(path):
    rig = killed_in_motion(path, theta=TWO_FAR)
    after = Next(rig, path)
    after.rig.call("configure")
    accept(after.kept, rig, ns=20)
    assert not after.told
    after.rig.t += 30.0
    accept(after.kept, rig, ns=30)
    [(_, stamp)] = after.told
    assert stamp == PlanStamp(9)
    assert load_left_plan(path.with_name("robots.plan"), rig.plane).stamp_ns == 30


def fill_disk(patch):
    def full(*_):
        raise BridgeError("no space left on device")

    patch.setattr("fiber_bus_bridge.node.kept_plan.save_left_plan", full)


def test_an_error_in_the_gaps_at_its_end_does_not_lose_the_result_of_a_plan(monkeypatch):
    rig = Rig()
    motion = rig.ready()
    rig.call("start")

    def fail(*_):
        raise ValueError("gaps")

    with monkeypatch.context() as patch:
        patch.setattr(ending, "learn_gaps", fail)
        with pytest.raises(ValueError, match="gaps"):
            rig.run()
    rig.call("stop")
    assert rig.session.state is SessionState.STOPPED
    result = rig.session.take_result()
    assert (result.outcome == Outcome.REACHED).all()
    assert np.array_equal(rig.where(), motion.end)
