# SPDX-License-Identifier: Apache-2.0
"""The bounds that follow from the terms of the sectors, and the settings that keep to them."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fiber_bus_bridge import SessionConfig
from fiber_core.clearance import Safety
from fiber_sectors import SectorError, Terms


@pytest.mark.parametrize("silence_ms", [1, 3, 4, 5])
def test_robots_rest_only_when_their_sector_no_longer_answers(silence_ms):
    # of the last heartbeats a sector answers until the next step, which may be late, is over
    answers_s = SessionConfig.heartbeat_period_s + Terms.step_s
    config = SessionConfig(silence_ms=silence_ms)
    if 1e-3 * silence_ms >= answers_s:
        Terms().check_session(config)
        return
    text = (
        rf"silence_ms is {silence_ms}, session.heartbeat_period_s 0.0025 s and terms.step_s 0.0025"
    )
    with pytest.raises(SectorError, match=text):
        Terms().check_session(config)


def test_a_step_that_is_longer_than_silence_allows_is_refused():
    terms = Terms(step_s=7.5e-3)
    with pytest.raises(SectorError, match=r"silence_ms is 5, .* terms.step_s 0.0075 s"):
        terms.check_session(SessionConfig())
    replace(terms, notice_s=10e-3).check_session(SessionConfig(silence_ms=10))


@pytest.mark.parametrize("drift_ppm", [0.0, 100.0, 1e5])
def test_on_slow_clocks_all_that_a_stop_waits_for_takes_longer(drift_ppm):
    right = replace(Terms(), drift_ppm=0.0)
    slow = replace(right, drift_ppm=drift_ppm)
    assert math.isclose(slow.stop_skew_s, (1.0 + 1e-6 * drift_ppm) * right.stop_skew_s)


def test_a_stop_waits_for_a_late_heartbeat_and_the_silence_after_it():
    terms = replace(Terms(), drift_ppm=0.0)
    late_s = terms.stop_skew_s - terms.fresh_s - terms.lease_s
    assert math.isclose(late_s, 2.0 * terms.notice_s)


def test_the_default_borders_contain_the_default_terms():
    Safety().check_borders(*Terms().border_skews_s(Safety()))
    needs_s = np.array(Terms().border_skews_s(Safety()))
    has_s = np.array([Safety.border_start_skew_s, Safety.border_stop_skew_s])
    assert (has_s - needs_s < 1e-3).all()  # and cost no more than they must
