# SPDX-License-Identifier: Apache-2.0
"""Robots at rest are told where a camera has seen them; nothing moves."""

import numpy as np
import pytest
from session_rig import Rig

from fiber_bus_bridge import SessionError, SessionState, place_robots, widen_outlines
from fiber_bus_bridge.wire import Fault, RobotState
from fiber_core.outcomes import Outcome


def test_encoders_read_what_was_measured_and_plans_begin_there():
    rig = Rig()
    rig.ready(400)
    rig.call("start")
    rig.run()
    wanted = rig.session.counts + np.array([[1234, -567]])
    chosen = np.arange(19) != 4
    took = place_robots(rig.session, wanted, chosen, rig.t)
    assert took.tolist() == chosen.tolist()
    assert np.array_equal(rig.session.counts[chosen], wanted[chosen])
    assert np.array_equal(rig.where(), rig.session.counts)
    assert (rig.robots.memory["state"][chosen] == RobotState.IDLE).all()
    # the next plan goes from there, relative as every plan
    before = rig.session.counts.copy()
    motion = rig.orders(-300, 0)
    rig.session.submit(motion)
    rig.call("start")
    assert (rig.run().outcome == Outcome.REACHED).all()
    assert np.array_equal(rig.where() - before, motion.end - motion.start)


def test_a_robot_with_orders_or_in_motion_is_not_told():
    rig = Rig()
    rig.ready()
    wanted, everyone = rig.session.counts + 5, np.ones(19, dtype=bool)
    with pytest.raises(SessionError, match="while READY"):
        place_robots(rig.session, wanted, everyone, rig.t)
    with pytest.raises(SessionError, match="while READY"):
        widen_outlines(rig.session, rig.plane, 0.1, 0.1)
    rig.call("start")
    assert rig.session.state is SessionState.MOVING
    with pytest.raises(SessionError, match="while MOVING"):
        place_robots(rig.session, wanted, everyone, rig.t)


def test_a_robot_that_refuses_is_named_by_its_reading():
    rig = Rig()
    rig.call("configure")
    rig.robots.memory["state"][3] = RobotState.FAULT
    wanted, everyone = rig.session.counts + 5, np.ones(19, dtype=bool)
    took = place_robots(rig.session, wanted, everyone, rig.t)
    assert np.flatnonzero(~took).tolist() == [3]
    assert rig.robots.memory["fault"][3] == Fault.WRONG_STATE
    with pytest.raises(SessionError, match="places of shape"):
        place_robots(rig.session, wanted[1:], everyone, rig.t)


def test_wider_outlines_hold_a_motion_that_would_pass_too_close():
    def started(wider_mm):
        rig = Rig(start=np.stack([np.zeros(19), np.full(19, 2.6)], axis=1))
        rig.call("configure")
        widen_outlines(rig.session, rig.plane, 0.0, wider_mm)
        rig.session.submit(rig.orders(400, -6000))
        rig.call("start")
        return rig.session.loaded_plan.started.sum()

    assert started(0.0) == 19
    assert started(3.0) < 19
    rig = Rig()
    rig.call("configure")
    with pytest.raises(SessionError, match="robot 0: outlines cannot grow"):
        widen_outlines(rig.session, rig.plane, 0.0, -1.0)
    widen_outlines(rig.session, rig.plane, 0.3, 0.2)
    widen_outlines(rig.session, rig.plane, 0.0, 0.1)  # not on top of what was there
    assert np.allclose(rig.session.plane.phi_radius, rig.plane.phi_radius + 0.1)
    assert np.allclose(rig.session.plane.theta_radius, rig.plane.theta_radius)
