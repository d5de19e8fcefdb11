# SPDX-License-Identifier: Apache-2.0
"""Motions without targets: which robots a call of `turn` means, and what a refused one leaves."""

from types import SimpleNamespace

import numpy as np
import pytest
from unplaced_rig import ALL, new_rig, place

from fiber_bus_bridge import SessionState
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.node.unplanned_motions import UnplannedMotions
from fiber_core.wire_units import WireMotion
from fiber_msgs_py import PlanStamp, turns


class Bridge:
    """What the motions need of a bridge, around a session with robots at unknown places."""

    def __init__(self):
        self.rig = new_rig()
        assert self.rig.session.robots["unplaced"].any()
        self.refused, self.ended, self.begun, self.published = [], [], [], []
        attempts = SimpleNamespace(
            inputs=SimpleNamespace(check_session=lambda message, name: None),
            check_turn_stamp=lambda stamp: None,
            end_all=lambda reason, why: self.ended.append(why),
            begin_unplanned=self.begun.append, ended=True,
        )  # fmt: skip
        reporter = SimpleNamespace(
            done=lambda *_: None, refuse=lambda why, *_: self.refused.append(why)
        )
        outgoing = SimpleNamespace(
            publish_layout=lambda: self.published.append("layout"),
            publish_encoders=lambda: self.published.append("encoders"),
        )
        self.unplanned = UnplannedMotions(
            self.rig.session, attempts, lambda: self.rig.t, lambda: None, lambda: True, lambda: "",
            outgoing, reporter,
        )  # fmt: skip

    def hear(self, ns, ids):
        ways = np.ones(len(ids), dtype=int)
        self.unplanned.hear_turns(turns.encode(ids, ways, PlanStamp(ns)))
        assert not self.refused


@pytest.fixture
def bridge():
    return Bridge()


def test_a_turn_that_this_bridge_has_not_heard_of_moves_no_robot(bridge):
    rig, before = bridge.rig, bridge.rig.where()
    # as a request that a new bridge gets again, or after another client has stopped the robots
    for forget in (lambda: None, lambda: bridge.hear(1, rig.plane.ids)):
        forget()
        bridge.unplanned.forget_turns()
        for _ in range(2):
            with pytest.raises(SessionError, match="no turns wait"):
                bridge.unplanned.turn()
    assert rig.session.state is SessionState.IDLE and np.array_equal(rig.where(), before)
    assert not bridge.ended and not bridge.begun


def test_turns_without_rows_are_of_robots_at_unknown_places_and_name_their_motion(bridge):
    bridge.hear(5, np.zeros(0, dtype=int))
    bridge.unplanned.turn()
    assert bridge.rig.session.state is SessionState.MOVING
    assert set(bridge.begun) == {PlanStamp(5)} and len(bridge.ended) == 1


def test_a_motion_that_is_refused_ends_no_plan_and_forgets_no_turns(bridge):
    session = bridge.rig.session
    session.submit(WireMotion.at_rest(session.units, session.counts))
    bridge.hear(7, np.zeros(0, dtype=int))
    for call in (bridge.unplanned.home, bridge.unplanned.turn):
        with pytest.raises(SessionError, match="while READY: start, or clear"):
            call()
    assert session.state is SessionState.READY and not bridge.ended
    session.clear(bridge.rig.t)
    bridge.unplanned.turn()  # which waited
    assert set(bridge.begun) == {PlanStamp(7)}


def test_a_turn_to_stops_tells_the_layout_before_any_image(bridge):
    rig = bridge.rig
    theta = np.where(np.arange(len(ALL)) == 3, 3.0, 0.0)  # of which another turn is in range
    counts = rig.units.encoder_counts(rig.plane, np.stack([theta, np.full(len(ALL), 2.6)], axis=1))
    place(rig, counts, ALL, turn_known=theta == 0.0)
    ids = rig.plane.ids[[3]]
    bridge.unplanned.hear_turns(turns.encode(ids, [turns.TO_UPPER_STOP], PlanStamp(9)))
    bridge.unplanned.turn()
    assert bridge.published == ["encoders", "layout"] and set(bridge.begun) == {PlanStamp(9)}
    assert np.array_equal(np.flatnonzero(rig.session.loaded_plan.started), [3])
    assert rig.session.robots["lost"][3]
