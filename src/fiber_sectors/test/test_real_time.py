# SPDX-License-Identifier: Apache-2.0
"""Sectors whose buses follow the clocks of their hosts, in slow motion: this machine has few cores.

A second of the clocks takes several of this machine, so that steps come on time; what waits, what
is late and what is measured is as at full speed.
"""

import numpy as np
import pytest
from plane_of_sectors import PlaneOfSectors, turning

from fiber_bus_bridge import SessionState
from fiber_core.outcomes import Outcome, Reason
from fiber_sectors import Stage, Terms, decode_report
from fiber_sectors.calls import CALL

pytestmark = pytest.mark.timeout(600)
SLOWLY = 0.05
APART_S = (0.0, 5000.0, -300.0)  # how far the clocks of the hosts are ahead


@pytest.fixture
def plane_of():
    made = []

    def make(**options):
        made.append(PlaneOfSectors(slowly=SLOWLY, ahead_s=APART_S, **options))
        made[-1].session.configure(made[-1].session.sectors.now_s())
        assert made[-1].session.known.all()
        return made[-1]

    yield make
    for each in made:
        each.close()


def begin(plane, ticks=20):
    session = plane.session
    session.submit(turning(session, ticks=ticks))
    session.start(session.sectors.now_s())


def test_sectors_with_clocks_of_their_own_start_together(plane_of):
    plane = plane_of()
    begin(plane)
    session = plane.session
    assert session.state is SessionState.MOVING and session.loaded_plan.started.all()
    bound_s = session.sectors.conductor.start_skew_bound_s
    assert 0.0 < bound_s <= Terms().start_skew_s
    starts_s = [s._session.loaded_plan.start_s - a for s, a in zip(plane.sectors, APART_S)]
    assert np.ptp(starts_s) <= bound_s
    for clock, ahead_s in zip(session.sectors.conductor.clocks, APART_S):
        offset = clock.offset(session.sectors.now_s())
        assert offset.low_s <= ahead_s <= offset.high_s
    plane.until_rest()
    assert (session.result.outcome == Outcome.REACHED).all()


def test_a_start_is_refused_when_the_clocks_are_not_known_well_enough(plane_of):
    plane = plane_of(late_s=5e-3)  # the offset is known to half of it
    begin(plane)
    session = plane.session
    assert session.state is SessionState.IDLE
    assert "the certificate contains 1 ms" in session.sectors.why
    assert (session.result.reason == Reason.STOPPED).all()
    start = plane.units.encoder_counts(plane.plane, plane.start)
    np.testing.assert_array_equal(session.counts, start)


def test_a_sector_at_rest_answers_no_beat_as_if_it_moved(plane_of, monkeypatch):
    plane = plane_of()
    sector, told, run = plane.sectors[1], [], []
    session, advance, send = sector._session, sector._session.advance, sector._send

    def stops_at_once(t):
        if plane.session.state is not SessionState.MOVING or run:
            return advance(t)
        session.stop(t)  # as after a fault
        run.append(sector.member.run)
        return t

    def listening(data):
        if run and data[:4] != CALL:
            told.append(decode_report(data))
        send(data)

    monkeypatch.setattr(session, "advance", stops_at_once)
    monkeypatch.setattr(sector, "_send", listening)
    begin(plane, 100)
    plane.until_rest()
    stages = {report.stage for report in told if report.run in run}
    assert stages == {Stage.STOPPED}
