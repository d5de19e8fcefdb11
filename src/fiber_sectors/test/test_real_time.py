# SPDX-License-Identifier: Apache-2.0
"""Sectors whose buses follow the clocks of their hosts, in slow motion: this machine has few cores.

A second of the clocks takes several of this machine, so that steps come on time; what waits, what
is late and what is measured is as at full speed.
"""

import time

import numpy as np
import pytest
from plane_of_sectors import PlaneOfSectors, turning

from fiber_bus_bridge import SessionState
from fiber_bus_bridge.wire import Opcode, encode_command, general_call
from fiber_core.outcomes import Outcome, Reason
from fiber_sectors import Stage, Terms, decode_report
from fiber_sectors.calls import CALL

pytestmark = pytest.mark.timeout(600)
SLOWLY = 0.025
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


def pause(clock_s):
    time.sleep(clock_s / SLOWLY)


def test_a_sector_that_was_paused_in_a_step_sends_no_heartbeat_after_its_lease(
    plane_of, monkeypatch
):
    plane = plane_of()
    sector, sent, paused = plane.sectors[1], [], []
    session, leased = sector._session, sector._leased
    advance, transfer = session.advance, leased._buses.transfer

    def late(t):
        if sector.member.stage is Stage.MOVING and not paused:
            paused.append(sector.member.lease_s)
            pause(2 * Terms.lease_s)
        return advance(t)

    def listening(frames, *more):
        if paused and len(frames.data):
            sent.append((sector._clock(), frames.data.tobytes()))
        return transfer(frames, *more)

    monkeypatch.setattr(session, "advance", late)
    monkeypatch.setattr(leased._buses, "transfer", listening)
    begin(plane, 100)
    plane.until_rest()
    buses = general_call(sector._session.transactions.buses)
    stop = encode_command(Opcode.STOP, buses).data.tobytes()
    assert sent[0][0] > paused[0] and sent[0][1].startswith(stop[: len(stop) // len(buses)])


def test_a_sector_whose_heartbeats_are_overdue_answers_no_beat_before_them(plane_of, monkeypatch):
    plane = plane_of()
    sector, events, paused = plane.sectors[1], [], []
    take, send = sector.inbox.take, sector._send
    step = sector._leased.advance_one_step

    def late(wait_s):
        if sector.member.stage is Stage.MOVING and not paused:
            pause(2.5 * Terms.step_s)
            paused.append(True)
        return take(wait_s)

    def listening(data):
        if paused and data[:4] != CALL:
            events.append(decode_report(data).stage)
        send(data)

    def stepping(*given):
        if paused:
            events.append("step")
        return step(*given)

    monkeypatch.setattr(sector.inbox, "take", late)
    monkeypatch.setattr(sector, "_send", listening)
    monkeypatch.setattr(sector._leased, "advance_one_step", stepping)
    begin(plane, 100)
    plane.until_rest()
    # a machine so late that the lease has ended takes no step
    before = events[: events.index("step")] if "step" in events else events
    assert events and Stage.MOVING not in before
