# SPDX-License-Identifier: Apache-2.0
"""A session with a plane of three sectors: one start, one stop, one outcome for each robot."""

import time
from dataclasses import replace

import numpy as np
import pytest
from plane_of_sectors import PlaneOfSectors, turning

from fiber_bus_bridge import (
    SessionConfig,
    SessionError,
    SessionState,
    place_robots,
    widen_outlines,
)
from fiber_bus_bridge.simulation import EVENT, Event, Faults
from fiber_core.clearance import Safety
from fiber_core.errors import MotionError
from fiber_core.outcomes import Outcome, Reason
from fiber_sectors import SectorError, Terms
from fiber_sectors.calls import CALL, Kind, decode_call, encode_call
from fiber_sectors.exchange import Pace
from fiber_sectors.sector import Sector
from fiber_sectors.sectored_session import SectoredSession

pytestmark = pytest.mark.timeout(600)  # the first motion compiles


@pytest.fixture
def plane_of():
    made = []

    def make(**options):
        made.append(PlaneOfSectors(**options))
        made[-1].session.configure(0.0)
        assert made[-1].session.known.all()
        return made[-1]

    yield make
    for each in made:
        each.close()


def starts_s(plane):
    return [each._session.loaded_plan.start_s for each in plane.sectors]


def test_sectors_start_together_and_reach_the_ends_of_their_orders(plane_of):
    plane = plane_of()
    session, orders = plane.session, turning(plane.session)
    session.submit(orders)
    session.start(0.0)
    assert session.state is SessionState.MOVING and session.loaded_plan.started.all()
    bound_s = session.sectors.conductor.start_skew_bound_s
    assert np.ptp(starts_s(plane)) <= bound_s <= Terms().start_skew_s
    assert abs(starts_s(plane)[0] - session.loaded_plan.start_s) <= bound_s
    plane.until_rest()
    assert (session.result.outcome == Outcome.REACHED).all()
    np.testing.assert_array_equal(session.counts, orders.end)
    positions = np.concatenate([b.positioners.memory["position"] for b in plane.buses])
    np.testing.assert_array_equal(positions, orders.end)
    frames = session.transactions.counters.table()
    assert all(figures["frames"] > 0 for figures in frames.values()) and len(frames) == 6


@pytest.mark.parametrize("what", ["crc", "terms", "in_real_time"])
def test_a_sector_that_holds_other_orders_or_terms_moves_nothing(plane_of, monkeypatch, what):
    plane = plane_of()
    session, orders = plane.session, turning(plane.session)
    told = plane.sectors[1]._loaded

    def told_otherwise():
        answer = told()
        return answer | {what: answer[what] + 1}

    monkeypatch.setattr(plane.sectors[1], "_loaded", told_otherwise)
    before = plane.buses[1].positioners.memory["position"].copy()
    session.submit(orders)
    session.start(0.0)
    plane.until_rest()
    np.testing.assert_array_equal(plane.buses[1].positioners.memory["position"], before)
    of_one = plane.plane.sector == 1
    assert (session.result.reason[of_one] == Reason.NOT_VERIFIED).all()
    assert (session.result.outcome[~of_one] == Outcome.REACHED).any()


def jammed(t):
    return Faults(events=np.array([(3, t, int(Event.JAM_THETA), 0)], dtype=EVENT))


def test_a_fault_in_one_sector_stops_all_and_the_others_resume(plane_of):
    plane = plane_of(faults={1: jammed(0.25)})
    session, orders = plane.session, turning(plane.session)
    session.submit(orders)
    session.start(0.0)
    plane.until_rest()
    assert session.sectors.why == "" or "sector 1" in session.sectors.why
    failed = int(np.flatnonzero(plane.plane.sector == 1)[3])
    result = session.result
    assert (result.outcome[failed], result.reason[failed]) == (Outcome.FAILED, Reason.STALLED)
    others = np.arange(plane.plane.n) != failed
    assert (result.outcome[others] == Outcome.REACHED).all()
    assert len(session.loaded_plans) == 2
    np.testing.assert_array_equal(session.counts[others], orders.end[others])


def test_a_lost_sector_stops_by_itself_and_the_others_go_on(plane_of):
    plane = plane_of()
    session, orders = plane.session, turning(plane.session)
    session.submit(orders)
    session.start(0.0)
    session.advance(session.transactions.now_s + 0.05)
    assert session.state is SessionState.MOVING
    plane.kill(1)
    plane.until_rest()
    lost = plane.plane.sector == 1
    result = session.result
    assert (result.outcome[lost] == Outcome.FAILED).all()
    assert set(result.reason[lost]) <= {Reason.BUS_FAILED, Reason.NO_REPLY}
    # its robots are where they stopped, or on their way there: whatever is beside them rests
    assert session.robots["lost"][lost].all() and not session.known[lost].any()
    beside = np.zeros(plane.plane.n, dtype=bool)
    pairs = session.protocol.pairs
    beside[pairs[lost[pairs].any(axis=1)].ravel()] = True
    away = ~lost & ~beside
    assert away.any() and (result.outcome[away] == Outcome.REACHED).all()
    assert (result.reason[~lost & beside] == Reason.PLACE_UNKNOWN).all()
    plane.join(1)
    ended = plane.sectors[1]
    ended_s = ended._session.transactions.now_s
    assert ended._session.state is SessionState.STOPPED
    assert ended_s <= ended.member.lease_s + Terms().notice_s + 5e-3
    # the next plan leaves them out
    session.clear(session.transactions.now_s)
    session.submit(turning(session, np.flatnonzero(away), velocity=-600))
    session.start(session.transactions.now_s)
    plane.until_rest()
    assert (session.result.outcome[away] == Outcome.REACHED).all()
    # and it is found again
    plane.revive(1)
    session.clear(session.transactions.now_s)
    assert session.known.all() and not session.robots["lost"].any()
    session.submit(turning(session, np.flatnonzero(lost), ticks=20))
    session.start(session.transactions.now_s)
    plane.until_rest()
    assert (session.result.outcome[lost] == Outcome.REACHED).all()


def test_lost_calls_beats_and_reports_come_again(plane_of):
    rng = np.random.default_rng(1)
    plane = plane_of(lossy=lambda _, data: data[:4] != CALL and rng.random() < 0.02)
    session = plane.session
    session.submit(turning(session, ticks=20))
    session.start(0.0)
    plane.until_rest()
    assert (session.result.outcome == Outcome.REACHED).all()


def test_an_order_that_the_border_makes_unsafe_is_held(plane_of):
    plane = plane_of()
    held = int(np.flatnonzero(plane.plane.sector == 2)[0])
    certify = plane.session.protocol.certify
    seen = []

    def unsafe(focal_plane, motion, safety):
        motion, mask, certificate = certify(focal_plane, motion, safety)
        seen.append(motion.moves.copy())
        return motion, mask | ((np.arange(focal_plane.n) == held) & motion.moves), certificate

    plane.session.protocol.certify = unsafe
    plane.session.submit(turning(plane.session))
    plane.session.start(0.0)
    plane.until_rest()
    result = plane.session.result
    assert (result.outcome[held], result.reason[held]) == (Outcome.HELD, Reason.UNSAFE_AS_LOADED)
    assert np.count_nonzero(result.outcome == Outcome.REACHED) == plane.plane.n - 1
    start = plane.units.encoder_counts(plane.plane, plane.start)
    np.testing.assert_array_equal(plane.session.counts[held], start[held])
    assert seen[0][held] and not seen[-1][held]


def test_a_stop_by_an_operator_stops_all_sectors(plane_of):
    plane = plane_of()
    session = plane.session
    session.submit(turning(session))
    session.start(0.0)
    session.advance(session.transactions.now_s + 0.05)
    session.stop(session.transactions.now_s)
    assert session.state is SessionState.STOPPED
    assert all(each._session.state is SessionState.STOPPED for each in plane.sectors)
    assert (session.result.reason == Reason.STOPPED).all()
    session.clear(session.transactions.now_s)
    assert session.state is SessionState.IDLE


def test_a_certificate_that_does_not_contain_the_terms_is_refused(plane_of):
    plane = plane_of()
    safety = Safety(border_stop_skew_s=20e-3)
    needs = r"safety.border_stop_skew_s is 0\.02 s, the terms of the sectors need 0\.02900"
    with pytest.raises(MotionError, match=needs):
        SectoredSession(
            plane.plane, plane.units, safety, plane.start, SessionConfig(), Terms(), plane, Pace()
        )


@pytest.mark.parametrize(
    ("config", "text"),
    [
        ({"silence_ms": 6}, r"session.silence_ms is 6, terms.notice_s 0.005 s"),
        ({"silence_ms": 0}, r"session.silence_ms is 0, .* 0 is never"),
        ({"heartbeat_period_s": 3e-3}, r"heartbeat_period_s is 0.003 s, terms.step_s 0.0025 s"),
    ],
)
def test_robots_that_do_not_keep_to_the_terms_are_refused(plane_of, config, text):
    plane = plane_of()
    coordinator = SessionConfig(**config)
    with pytest.raises(SectorError, match=text):
        SectoredSession(
            plane.plane, plane.units, Safety(), plane.start, coordinator, Terms(), plane, Pace()
        )
    session = plane.sectors[0]._session
    session.config = replace(session.config, **config)
    with pytest.raises(SectorError, match=text):
        Sector(0, session, Terms(), 1, lambda _: None)


def silent(rows):
    """Robots without power from the begin."""
    events = [(row, 0.0, int(Event.POWER), 0) for row in rows]
    return Faults(events=np.array(events, dtype=EVENT))


def test_a_vouched_place_is_believed_by_its_sector_and_stays_so(plane_of):
    plane = PlaneOfSectors(faults={1: silent([3])})
    session = plane.session
    try:
        session.configure(0.0)
        row = int(np.flatnonzero(plane.plane.sector == 1)[3])
        assert session.robots["lost"][row] and not session.known[row]
        session.vouch([plane.plane.ids[row]])
        assert not plane.sectors[1]._session.robots["lost"].any()
        session.submit(turning(session))
        session.start(session.transactions.now_s)
        plane.until_rest()
        # its neighbours move, in its sector too, and it stays an obstacle
        others = np.arange(plane.plane.n) != row
        assert (session.result.outcome[others] == Outcome.REACHED).all()
        assert not session.robots["lost"][row] and not session.known[row]
    finally:
        plane.close()


def test_a_place_vouched_for_while_its_sector_is_away_is_told_to_the_sector(plane_of):
    plane = PlaneOfSectors(faults={1: silent([3])})
    session = plane.session
    try:
        plane.kill(1)
        plane.join(1)
        session.configure(0.0)
        of_one = plane.plane.sector == 1
        assert session.robots["lost"][of_one].all()
        session.vouch(plane.plane.ids[of_one])
        plane.revive(1)
        session.configure(session.transactions.now_s)
        assert session.known[of_one].sum() == of_one.sum() - 1
        assert not session.robots["lost"].any()
    finally:
        plane.close()


def test_vouching_for_a_robot_at_a_known_place_is_refused(plane_of):
    plane = plane_of()
    with pytest.raises(SessionError, match="its place is known"):
        plane.session.vouch([plane.plane.ids[0]])


def test_a_coordinator_whose_clock_is_behind_the_one_before_is_heard(plane_of):
    plane = plane_of()
    refused = []
    session = SectoredSession(
        plane.plane, plane.units, Safety(), plane.start, SessionConfig(tolerance_mm=1e-3), Terms(),
        plane, Pace(patience_s=3.0, number=lambda: 1),
    )  # fmt: skip
    plane.sectors[0].inbox.put(encode_call(0, Kind.STOP, 5, {}))
    begin_s = time.monotonic()
    while not refused and time.monotonic() < begin_s + 60.0:
        calls = [decode_call(data) for data in plane.receive(1.0) if data[:4] == CALL]
        refused += [call.refusal for call in calls if call.number == 5]
    assert "call 5 comes after call" in refused[0]
    session.configure(0.0)
    assert session.known.all()
    session.submit(turning(session, ticks=20))
    session.start(0.0)
    plane.session = session
    plane.until_rest()
    assert (session.result.outcome == Outcome.REACHED).all()


def test_a_sector_that_ends_as_a_run_begins_moves_nothing(plane_of, monkeypatch):
    plane = plane_of()
    session, member = plane.session, plane.sectors[1].member
    begin = member.begin

    def ended_just_before(*given):
        plane.sectors[1].end()
        return begin(*given)

    monkeypatch.setattr(member, "begin", ended_just_before)
    before = plane.buses[1].positioners.memory["position"].copy()
    session.submit(turning(session))
    session.start(0.0)
    plane.until_rest()
    np.testing.assert_array_equal(plane.buses[1].positioners.memory["position"], before)
    assert member.why == "the sector ends"


def test_places_that_a_camera_saw_are_refused_with_a_reason(plane_of):
    session = plane_of().session
    n = session.plane.n
    with pytest.raises(SessionError, match="a camera needs one bridge"):
        place_robots(session, session.counts + 5, np.ones(n, dtype=bool), 0.0)
    with pytest.raises(SessionError, match="a camera needs one bridge"):
        widen_outlines(session, session.plane, 0.1, 0.1)


def test_a_plane_of_sectors_believes_counters(plane_of):
    plane = plane_of()
    with pytest.raises(SectorError, match="session.counters_kept is false: a plane of sectors"):
        SectoredSession(
            plane.plane, plane.units, Safety(), plane.start,
            SessionConfig(counters_kept=False), Terms(), plane, Pace(),
        )  # fmt: skip
