# SPDX-License-Identifier: Apache-2.0
"""A coordinator that was killed: another one finds all sectors at once."""

import numpy as np
import pytest
from plane_of_sectors import PlaneOfSectors, turning

from fiber_bus_bridge import SessionConfig
from fiber_bus_bridge.protocol import State
from fiber_bus_bridge.wire import Alert
from fiber_core.clearance import Safety
from fiber_core.outcomes import Reason
from fiber_sectors import Terms
from fiber_sectors.calls import CALL, Kind, decode_call
from fiber_sectors.exchange import Pace
from fiber_sectors.sectored_session import SectoredSession


class _KilledError(Exception):
    pass


@pytest.mark.parametrize("stage", [State.VERIFIED, State.CERTIFIED])
def test_sectors_that_wait_for_a_coordinator_that_was_killed_answer_the_next_one(stage):
    plane = PlaneOfSectors()
    session = plane.session

    def killed(_):
        raise _KilledError

    session.configure(0.0)
    session.submit(turning(session))
    session.protocol.steps[stage] = killed
    with pytest.raises(_KilledError):
        session.start(0.0)
    after = SectoredSession(
        plane.plane, plane.units, Safety(), plane.start, SessionConfig(), Terms(), plane,
        Pace(patience_s=3.0, call_s=5.0),
    )  # fmt: skip
    after.configure(0.0)
    assert after.known.all() and not after.sectors.gone
    plane.close()


def killed_in_motion(plane):
    """The coordinator is killed in motion; robot 5 of sector 0 was jammed, 6 has lost its power."""
    session = plane.session
    session.configure(0.0)
    session.submit(turning(session, ticks=1000))
    session.start(0.0)
    at_s = session.loaded_plan.start_s + 0.1
    session.advance(at_s)
    robots = plane.buses[0].positioners
    robots.memory["jam_s"][5] = at_s
    robots.power([6], False, at_s + 1e-3)

    def killed(_):
        raise _KilledError

    session.protocol.steps[State.MOVING] = killed
    with pytest.raises(_KilledError):
        session.advance(at_s + 0.2)


@pytest.mark.parametrize("anew", [False, True])
def test_a_new_coordinator_learns_and_notes_why_robots_rest_before_they_forget_it(anew):
    plane = PlaneOfSectors()
    killed_in_motion(plane)
    rows, memory = np.flatnonzero(plane.plane.sector == 0), plane.buses[0].positioners.memory
    if anew:
        plane.kill(0)
        plane.begin_anew(0)
    after, noted = plane.new_session(), []

    def note(at_rest):
        noted.append((at_rest, after.robots["rest_cause"].copy(), memory["alerts"][5]))

    after.look_back(note)
    after.configure(0.0)
    at_rest, cause, alerts = noted[0]
    assert alerts & Alert.STALLED, "it has not forgotten why"
    assert at_rest[rows[5]] and cause[rows[5]] == Reason.STALLED
    assert not at_rest[rows[6]] and cause[rows[6]] == Reason.NO_REPLY
    others = np.ones(plane.plane.n, dtype=bool)
    others[rows[[5, 6]]] = False
    assert at_rest[others].all()
    assert np.isin(cause[others], (Reason.STOPPED, Reason.NO_HEARTBEAT)).all()
    np.testing.assert_array_equal(after.robots["rest_cause"], cause)
    assert after.known[others].all() and after.robots["state"][rows[6]] == 0
    plane.close()


def test_a_sector_that_does_not_tell_why_its_robots_rest_is_not_configured():
    def is_look_at_1(_, data):
        if data[:4] != CALL:
            return False
        call = decode_call(data)
        return call.kind is Kind.LOOK and call.sector == 1

    plane = PlaneOfSectors(lossy=is_look_at_1)
    killed_in_motion(plane)
    plane.kill(1)
    plane.begin_anew(1)
    before = plane.buses[1].positioners.memory.copy()
    after, noted = plane.new_session(call_s=3.0), []
    after.look_back(noted.append)
    after.configure(0.0)
    silent = plane.plane.sector == 1
    assert not noted[0][silent].any() and not after.known[silent].any()
    assert (after.robots["rest_cause"][silent] == Reason.BUS_FAILED).all()
    memory = plane.buses[1].positioners.memory
    for name in ("state", "fault", "alerts"):
        np.testing.assert_array_equal(memory[name], before[name])
    after.clear(0.0)
    assert after.known[silent].all(), "a later call finds it"
    plane.close()
