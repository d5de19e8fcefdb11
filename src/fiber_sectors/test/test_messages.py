# SPDX-License-Identifier: Apache-2.0
"""Beats and reports as bytes, and the terms."""

import math

import pytest

from fiber_sectors import (
    Beat,
    ClockFit,
    Order,
    Report,
    SectorError,
    Stage,
    Terms,
    decode_beat,
    decode_report,
    encode_beat,
    encode_report,
)

BEAT = Beat(2**60, 3, Order.MOVE, 1.5, (7, 0), (0.25, -1.0), (2.0, 3.0))
REPORT = Report(1, 2**62, 2**60, Stage.COUNTING, 0.25, 1.5, 0.125, 2.0)


def test_messages_come_back_as_they_were():
    assert decode_beat(encode_beat(BEAT)) == BEAT
    assert decode_report(encode_report(REPORT)) == REPORT


@pytest.mark.parametrize("data", [b"", b"FSB1", encode_beat(BEAT)[:-1], encode_report(REPORT)])
def test_what_is_no_beat_is_refused(data):
    with pytest.raises(SectorError, match="no beat"):
        decode_beat(data)


@pytest.mark.parametrize("data", [b"", encode_report(REPORT)[1:], encode_report(REPORT) + b"x"])
def test_what_is_no_report_is_refused(data):
    with pytest.raises(SectorError, match="no report"):
        decode_report(data)


def test_unknown_orders_and_stages_are_refused():
    data = bytearray(encode_report(REPORT))
    data[22] = 99
    with pytest.raises(SectorError, match="stage 99"):
        decode_report(bytes(data))


def test_a_lease_shorter_than_two_beats_is_refused():
    with pytest.raises(SectorError, match=r"lease_s is 0\.005 s"):
        Terms(lease_s=5e-3)
    with pytest.raises(SectorError, match="period_s"):
        Terms(period_s=math.nan)


def test_the_offset_is_within_its_bound_and_a_jump_is_seen():
    fit = ClockFit(100.0)
    assert fit.offset(0.0).bound_s == math.inf
    for k in range(50):  # clock ahead by 3 s, unequal delays
        t = 0.1 * k
        there_s, back_s = (2e-3, 1e-4) if k % 2 else (1e-4, 3e-3)
        heard_s = t + there_s + 3.0
        fit.add(t, heard_s, heard_s + 1e-3, t + there_s + 1e-3 + back_s)
        found = fit.offset(t)
        assert abs(found.middle_s - 3.0) <= found.bound_s
    assert fit.jumps == 0 and fit.offset(t).bound_s < 2e-4
    fit.add(6.0, 9.5, 9.5, 6.001)
    assert fit.jumps == 1
    assert fit.offset(6.0).middle_s == pytest.approx(3.4995)
