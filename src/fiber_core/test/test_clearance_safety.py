# SPDX-License-Identifier: Apache-2.0
"""The required gap is enough for wrong clocks and late starts and stops, and no more."""

from dataclasses import replace

import numpy as np
import pytest
from random_motions import RESOLVE_ALL, all_at, angles_at, random_motion

from fiber_core.clearance import (
    Safety,
    certify,
    levers_of,
    neighbour_pairs,
    point_speeds,
    sampled_gaps,
)
from fiber_core.errors import MotionError
from fiber_core.motion import SegmentMotion
from fiber_core.presets import PRESETS, plane_from, preset


@pytest.mark.parametrize("name", ["desi", "desi_outlines", "sdss_v"])
def test_no_motion_requires_more_than_at_full_speed(name):
    rng = np.random.default_rng(4)
    plane = preset(name, 40)
    safety, pairs = Safety(0.1, 200.0, 1e-3), neighbour_pairs(plane)
    lasting = np.arange(81), np.full(80, 2.0)
    full = SegmentMotion(np.zeros((40, 2)), *lasting, plane.speeds.ravel())
    most = safety.required_at(point_speeds(levers_of(plane), plane.speeds), 2.0, pairs)
    np.testing.assert_allclose(most, safety.required_mm(plane, full, pairs))
    speeds = rng.uniform(-1, 1, 80) * plane.speeds.ravel()
    slower = SegmentMotion(np.zeros((40, 2)), *lasting, speeds)
    required = safety.required_mm(plane, slower, pairs)
    assert np.all((safety.margin_mm <= required) & (required <= most + 1e-12))


def _gap_lost(plane, motion, safety, pairs, clocks):
    """Return the loss of gap of each pair by clock errors and late starts, over its allowance.

    Args:
        plane, motion, safety, pairs: as for certify; the margin plays no role.
        clocks: for each trial, rates of the robots' clocks and how late they start [s].
    """
    nominal = certify(plane, motion, RESOLVE_ALL, pairs).gap_mm
    speeds = point_speeds(levers_of(plane), motion.fastest)
    allowance = replace(safety, margin_mm=0.0).required_at(speeds, motion.makespan_s, pairs)
    t = np.linspace(0.0, 1.1 * motion.makespan_s + safety.start_skew_s, 800)
    lost = np.zeros(len(pairs))
    for rate, late in clocks:
        own = np.clip(rate[:, None] * (t - late[:, None]), 0.0, None)
        actual = sampled_gaps(plane, pairs, angles_at(motion, own)).min(axis=1)
        lost = np.maximum(lost, nominal - actual)
    return lost, allowance


@pytest.mark.parametrize(
    "ppm, skew_s, least_share", [(1e4, 0.0, 0.6), (0.0, 0.02, 0.3), (1e4, 0.02, 0.4)]
)
def test_allowance_is_needed_and_enough_for_one_robot_close_behind_another(
    ppm, skew_s, least_share
):
    # Arms at full stretch meet between their centres and sweep the same way, 0 ahead of 1
    # by 3 mm; the last instants before both arrive are where a wrong clock matters most.
    plane = replace(preset("desi", 2), centers=[[0.0, 0.0], [13.0, 0.0]])
    plane = replace(plane, limits=np.tile([-9.0, 9.0], (2, 2, 1)))
    start = [[0.25 - 4.5, 0.0], [np.pi + 0.25 + 4.5, 0.0]]
    motion = SegmentMotion(start, [0, 1, 1, 2, 2], [1.5, 1.5], [3.0, -3.0])
    clocks = [
        (1 + ppm * 1e-6 * np.array(rate), skew_s * np.array(late))
        for rate in ([1, 1], [1, -1], [-1, 1], [-1, -1])
        for late in ([0, 0], [0, 1], [1, 0], [1, 1])
    ]
    safety = Safety(clock_ppm=ppm, start_skew_s=skew_s)
    lost, allowance = _gap_lost(plane, motion, safety, [(0, 1)], clocks)
    assert least_share * allowance < lost <= allowance


@pytest.mark.parametrize("name", ["desi", "desi_outlines", "sdss_v"])
def test_allowance_covers_clock_error_and_start_skew_of_random_motions(name):
    rng = np.random.default_rng(1)
    plane = replace(preset(name, 30), limits=np.tile([-9.0, 9.0], (30, 2, 1)))
    for _ in range(3):
        clocks = [
            (1 + 1e-2 * rng.choice([-1, 1], 30), 0.02 * rng.integers(0, 2, 30)) for _ in range(6)
        ]
        safety = Safety(clock_ppm=1e4, start_skew_s=0.02)
        motion = random_motion(rng, 30, most=2)
        lost, allowance = _gap_lost(plane, motion, safety, neighbour_pairs(plane), clocks)
        assert (lost <= allowance + 1e-9).all()
        assert lost.max() > 0.05


@pytest.mark.parametrize("name", ["desi", "desi_outlines", "sdss_v"])
def test_robots_that_stop_apart_in_time_use_up_the_margin_and_no_more(name):
    rng = np.random.default_rng(2)
    plane = replace(preset(name, 30), limits=np.tile([-9.0, 9.0], (30, 2, 1)))
    pairs, safety = neighbour_pairs(plane), Safety(0.0, 0.0, 0.0, stop_skew_s=0.02)
    worst = 0.0
    for _ in range(3):
        motion = random_motion(rng, 30, most=2)
        speeds = point_speeds(levers_of(plane), motion.fastest)
        required = safety.required_at(speeds, motion.makespan_s, pairs)
        for stop_s in rng.uniform(0.0, motion.makespan_s, 20):
            instants = all_at(motion, [stop_s, stop_s + 0.02])
            together = sampled_gaps(plane, pairs, instants).min(axis=1)
            late = stop_s + 0.02 * rng.integers(0, 2, (30, 1))
            apart = sampled_gaps(plane, pairs, angles_at(motion, late))[:, 0]
            assert (together - apart <= required + 1e-9).all()
            worst = max(worst, (together - apart).max())
    assert worst > 0.1
    one = point_speeds(levers_of(plane), plane.speeds)
    both = replace(safety, margin_mm=0.05, start_skew_s=1e-3).required_at(one, 0.0, pairs)
    slower = one[pairs].min(axis=1)
    np.testing.assert_allclose(both, np.maximum(0.05 + 1e-3 * slower, 0.021 * slower))


@pytest.mark.parametrize("gap_mm", [0.03, 0.0, -0.4])
def test_one_of_a_pair_that_starts_too_close_may_leave_but_not_come_closer(gap_mm):
    # two robots tip to tip
    plane = plane_from(PRESETS["desi"], np.arange(2), [[0.0, 0.0], [14.0 + gap_mm, 0.0]])
    start = np.array([[0.0, 0.0], [np.pi, 0.0]])

    def turned(first, second, start=start):
        motion = SegmentMotion(start, [0, 1, 1, 2, 2], [2.0, 2.0], [first, second])
        return certify(plane, motion, Safety())

    for alone in (turned(0.2, 0.0), turned(0.0, -0.2)):
        assert alone.ok
        assert alone.required_mm[0] == pytest.approx(gap_mm - 1e-3, abs=1e-9)
    assert not turned(0.2, 0.2).ok  # with timing errors, two moving robots could touch
    assert not turned(0.0, 0.0).ok
    beyond = np.array([[0.1, 0.0], [np.pi, 0.0]])
    assert not turned(-0.1, 0.0, beyond).ok  # through the other robot


def test_only_pairs_across_a_border_pay_for_its_skews():
    plane = preset("desi", 60)
    halves = replace(plane, sector=(plane.centers[:, 0] > np.median(plane.centers[:, 0])) * 3)
    pairs, safety = neighbour_pairs(plane), Safety(0.05, 0.0, 0.0, 4e-3, 2e-3, 36e-3)
    lasting = np.arange(121), np.full(120, 2.0)
    motion = SegmentMotion(np.zeros((60, 2)), *lasting, plane.speeds.ravel())
    one, two = safety.required_mm(plane, motion, pairs), safety.required_mm(halves, motion, pairs)
    border = halves.sector[pairs[:, 0]] != halves.sector[pairs[:, 1]]
    assert 0 < border.sum() < len(pairs) / 3
    np.testing.assert_array_equal(one[~border], two[~border])
    slower = point_speeds(levers_of(plane), plane.speeds)[pairs].min(axis=1)
    np.testing.assert_allclose(two[border], (0.038 * slower)[border])
    # the certificate examines all pairs that the border makes doubtful, and finds these
    certificate = certify(halves, motion, safety)
    assert certificate.required_mm.max() == pytest.approx(two.max())
    assert len(certificate.pairs) >= len(certify(plane, motion, safety).pairs)
    worst = safety.anywhere(halves).required_mm(plane, motion, pairs)
    np.testing.assert_allclose(worst.max(), two.max())
    assert safety.anywhere(plane) is safety


def test_obstacles_belong_to_no_sector():
    plane = preset("desi", 20)
    disc = np.array([[*plane.centers[0] + [9.0, 0.0], 1.0]])
    plane = replace(plane, obstacles=disc, sector=np.arange(20) % 2)
    pairs = np.stack([np.arange(20), np.full(20, 20)], axis=1)
    speeds = point_speeds(levers_of(plane), plane.speeds)
    required = Safety().required_at(speeds, 1.0, pairs, sector=plane.sector)
    np.testing.assert_array_equal(required, Safety().required_at(speeds, 1.0, pairs))


@pytest.mark.parametrize("name", ["border_start_skew_s", "border_stop_skew_s"])
def test_skews_of_borders_smaller_than_sectors_need_are_refused_with_both_values(name):
    safety = Safety()
    needs_s = (safety.border_start_skew_s, safety.border_stop_skew_s)
    safety.check_borders(*needs_s)
    with pytest.raises(MotionError, match=rf"direct.{name} is 0\.001 s, .* need 0\.0"):
        replace(safety, **{name: 1e-3}).check_borders(*needs_s, "direct")
