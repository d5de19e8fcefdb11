# SPDX-License-Identifier: Apache-2.0
"""Motions without targets: which robots a call of `turn` means."""

from types import SimpleNamespace

import numpy as np
import pytest
from unplaced_rig import new_rig

from fiber_bus_bridge import SessionState
from fiber_bus_bridge.errors import SessionError
from fiber_bus_bridge.node.unplanned_motions import UnplannedMotions
from fiber_msgs_py import PlanStamp, turns


def test_a_turn_whose_code_words_were_forgotten_turns_no_robot_at_an_unknown_place():
    rig, refused = new_rig(), []
    assert rig.session.robots["unplaced"].any()
    attempts = SimpleNamespace(
        inputs=SimpleNamespace(check_session=lambda message, name: None),
        end_all=lambda reason, why: None, begin_home=lambda: None, ended=True,
    )  # fmt: skip
    reporter = SimpleNamespace(done=lambda *_: None, refuse=lambda why, *_: refused.append(why))
    unplanned = UnplannedMotions(
        rig.session, attempts, lambda: rig.t, lambda: None, lambda: True, lambda: "", reporter
    )
    before = rig.where()
    unplanned.hear_turns(turns.encode(rig.plane.ids, np.ones(rig.plane.n, int), PlanStamp(1)))
    assert not refused
    unplanned.forget_turns()  # as another client stops the robots, and clears
    with pytest.raises(SessionError, match="the turns that waited were forgotten"):
        unplanned.turn()
    assert rig.session.state is SessionState.IDLE and np.array_equal(rig.where(), before)
    unplanned.turn()  # the next call means the robots at unknown places
    assert rig.session.state is SessionState.MOVING
