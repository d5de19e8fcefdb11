# SPDX-License-Identifier: Apache-2.0
"""A coordinator that was killed: another one finds all sectors at once."""

import pytest
from plane_of_sectors import PlaneOfSectors, turning

from fiber_bus_bridge import SessionConfig
from fiber_bus_bridge.protocol import State
from fiber_core.clearance import Safety
from fiber_sectors import Terms
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
