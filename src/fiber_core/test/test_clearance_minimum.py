# SPDX-License-Identifier: Apache-2.0
"""The smallest gap of a motion against gaps that are known by a formula."""

import numpy as np
import pytest
from random_motions import RESOLVE_ALL, Fixed

from fiber_core.clearance import (
    Safety,
    bodies_of,
    certify,
    smallest_gaps,
    unproven,
)
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion

_ARM1, _TIP, _TIP_RADIUS = 3.0, 2.0, 0.25
_STRETCHED_MM = _ARM1 + _TIP


def _plane(n, discs) -> FocalPlane:
    """Return robots 100 mm apart, each a small disc at the tip of two thin links, and discs."""
    return FocalPlane(
        ids=np.arange(n),
        centers=np.stack([100.0 * np.arange(n), np.zeros(n)], axis=1),
        arms=np.tile([_ARM1, _TIP], (n, 1)),
        limits=np.tile([-50.0, 50.0], (n, 2, 1)),
        speeds=np.full((n, 2), 1e3),
        phi_vertices=np.tile([[_TIP, 0.0]], (n, 1, 1)),
        phi_radius=np.full(n, _TIP_RADIUS),
        theta_vertices=np.zeros((n, 0, 2)),
        theta_radius=np.zeros(n),
        enabled=np.ones(n, dtype=bool),
        obstacles=np.array(discs, dtype=float).reshape(-1, 3),
    )


def _swept(durations, speeds, start=0.0):
    """Lowest and highest angle of a joint, and the instants at which its segments end."""
    angles = start + np.concatenate([[0.0], np.cumsum(np.multiply(durations, speeds))])
    return angles.min(), angles.max(), angles


_SWEEPS = {
    # durations and speeds of the segments of one joint
    "one segment": ([1.0], [2.0]),
    "one segment backwards": ([1.0], [-2.0]),
    "there and back": ([0.7, 0.7], [3.0, -3.0]),
    "slow, rest, fast": ([1.0, 0.5, 0.2], [0.5, 0.0, 8.0]),
    "rests at first and at the end": ([0.4, 0.6, 0.3], [0.0, -4.0, 0.0]),
}


@pytest.mark.parametrize("at", [0.3, 0.9, 1.5, -0.9, -1.9, 3.0])
@pytest.mark.parametrize("sweep", _SWEEPS)
@pytest.mark.parametrize("joint", [0, 1], ids=["theta", "phi"])
def test_a_tip_that_turns_past_a_disc_comes_as_near_as_its_circle(joint, sweep, at):
    # The tip moves on a circle about the axis of theta, or about the elbow. The disc stands outside
    # of the circle in the direction `at`; the nearest angle is `at` if it is swept, else an end.
    durations, speeds = _SWEEPS[sweep]
    low, high, angles = _swept(durations, speeds)
    radius, axis = (_STRETCHED_MM, 0.0) if joint == 0 else (_TIP, _ARM1)
    away = radius + 1.0
    plane = _plane(1, [[axis + away * np.cos(at), away * np.sin(at), 0.125]])
    counts = [len(durations), 0] if joint == 0 else [0, len(durations)]
    motion = SegmentMotion([[0.0, 0.0]], np.cumsum([0, *counts]), durations, speeds)
    found = certify(plane, motion, RESOLVE_ALL, [(0, 1)], 1e-6)
    turns = at + np.array([0.0, 2 * np.pi, -2 * np.pi])  # the same direction
    ends = np.clip(turns, low, high)
    at, nearest = min(zip(turns, ends), key=lambda pair: abs(pair[0] - pair[1]))
    chord = np.sqrt(radius**2 + away**2 - 2 * radius * away * np.cos(at - nearest))
    gap = chord - _TIP_RADIUS - 0.125
    assert gap - 1e-5 <= found.gap_mm[0] <= gap
    assert found.min_pair == (0, 1) and found.min_gap_mm == found.gap_mm[0]
    # the instant is one at which the joint is there
    knots = np.concatenate([[0.0], np.cumsum(durations)])
    assert np.interp(found.time_s[0], knots, angles) == pytest.approx(nearest, abs=5e-3)


def test_both_joints_of_both_robots_are_part_of_a_motion():
    # Two robots of which each joint moves in turn, one joint at a time, so that the instant of the
    # smallest gap lies in a segment of each of the four joints once.
    plane = _plane(2, [])
    plane = FocalPlane(**{**_columns(plane), "centers": [[0.0, 0.0], [10.5, 0.0]]})
    for joint in range(4):
        start = np.array([[0.0, 0.0], [np.pi, 0.0]])
        start.ravel()[joint] += 0.5
        counts, speeds = np.zeros(4, dtype=int), np.array([-1.0])
        counts[joint] = 1
        motion = SegmentMotion(start, np.concatenate([[0], np.cumsum(counts)]), [1.0], speeds)
        found = certify(plane, motion, RESOLVE_ALL, [(0, 1)], 1e-6)
        assert found.gap_mm[0] == pytest.approx(0.5 - 2 * _TIP_RADIUS, abs=1e-5)
        assert found.time_s[0] == pytest.approx(0.5, abs=5e-3)
        late = SegmentMotion(start, motion.offsets, [0.25], speeds)
        found = certify(plane, late, RESOLVE_ALL, [(0, 1)], 1e-6)
        assert found.gap_mm[0] > 0.02 and found.time_s[0] == pytest.approx(0.25, abs=1e-6)


def _columns(plane: FocalPlane) -> dict:
    names = "ids centers arms limits speeds phi_vertices phi_radius theta_vertices theta_radius"
    return {name: getattr(plane, name) for name in [*names.split(), "enabled", "obstacles"]}


def test_opposite_joints_leave_the_direction_of_a_phi_link_as_it_is():
    # theta turns forward as fast as phi turns back: the tip circles about (2, 0) with the elbow
    plane = _plane(1, [[_TIP + 4.0 * np.cos(1.0), 4.0 * np.sin(1.0), 0.5]])
    motion = SegmentMotion([[0.0, 0.0]], [0, 1, 2], [2.0, 2.0], [1.0, -1.0])
    found = certify(plane, motion, RESOLVE_ALL, [(0, 1)], 1e-6)
    assert found.gap_mm[0] == pytest.approx(4.0 - _ARM1 - 0.5 - _TIP_RADIUS, abs=1e-5)
    assert found.time_s[0] == pytest.approx(1.0, abs=5e-3)


def test_segments_of_the_joints_may_begin_and_end_at_any_instants():
    # The tip is stretched only while 0.4 < t < 0.45, with theta at 1 just then.
    plane = _plane(1, [[6.0 * np.cos(1.0), 6.0 * np.sin(1.0), 0.5]])
    bends = [0.4, 0.05, 0.3]
    motion = SegmentMotion(
        [[0.0, 1.0]],
        [0, 3, 6],
        [0.425, 0.01, 0.2, *bends],
        [1.0 / 0.425, 0.0, 3.0, -2.5, 0.0, 2.5],
    )
    found = certify(plane, motion, RESOLVE_ALL, [(0, 1)], 1e-6)
    assert found.gap_mm[0] == pytest.approx(1.0 - 0.5 - _TIP_RADIUS, abs=1e-5)
    assert 0.425 - 2e-3 < found.time_s[0] < 0.435 + 2e-3


@pytest.mark.parametrize("first, second", [(2.0, 1.0), (1.0, 2.0), (0.5, 3.0)])
def test_a_theta_link_is_part_of_a_robot(first, second):
    # A theta outline longer than the robot is stretched turns past two discs.
    columns = _columns(_plane(1, [[0.0, 9.0 + first, 0.25], [-9.0 - second, 0.0, 0.25]]))
    columns |= {"theta_vertices": [[[0.0, 0.0], [8.0, 0.0]]], "theta_radius": [0.5]}
    plane = FocalPlane(**columns)
    motion = SegmentMotion([[0.0, 1.0]], [0, 1, 1], [4.0], [1.0])
    found = certify(plane, motion, RESOLVE_ALL, [(0, 1), (0, 2)], 1e-6)
    expected = [1.0 + first - 0.75, 1.0 + second - 0.75]
    np.testing.assert_allclose(found.gap_mm, expected, atol=1e-5)
    np.testing.assert_allclose(found.time_s, [np.pi / 2, np.pi], atol=5e-3)
    assert found.min_gap_mm == found.gap_mm.min()
    assert found.min_pair == (0, 1 + int(second < first))
    assert found.min_time_s == found.time_s[np.argmin(found.gap_mm)]


def _many_discs():
    """A robot that turns once, and discs around its circle at gaps 0.1, 0.2, ... 1.2 mm."""
    gaps = 0.1 * np.arange(1, 13)
    at = np.linspace(0.4, 5.9, 12)[[3, 7, 0, 11, 5, 1, 9, 2, 8, 4, 10, 6]]
    away = _STRETCHED_MM + _TIP_RADIUS + 0.25 + gaps
    discs = np.stack([away * np.cos(at), away * np.sin(at), np.full(12, 0.25)], axis=1)
    motion = SegmentMotion([[0.0, 0.0]], [0, 1, 1], [2 * np.pi], [1.0])
    return _plane(1, discs), motion, gaps, at


@pytest.mark.parametrize("margin", [0.05, 0.35, 0.75, 2.0])
def test_unsafe_pairs_are_those_below_the_margin_and_their_gaps_are_resolved(margin):
    plane, motion, gaps, at = _many_discs()
    pairs = [(0, 1 + k) for k in range(12)]
    found = certify(plane, motion, Fixed(margin), pairs)
    assert found.unsafe.tolist() == (gaps < margin).tolist()
    assert found.unsafe_robots.tolist() == [margin > 0.1]
    assert found.ok == (margin < 0.1)
    assert (found.gap_mm <= gaps).all()
    resolved = (gaps < margin) | (gaps == 0.1)
    assert (gaps - found.gap_mm <= 1e-3)[resolved].all()
    assert found.min_pair == (0, 1)
    assert found.min_time_s == pytest.approx(at[0], abs=0.05)
    bodies = bodies_of(plane)
    required = np.full(12, margin)
    assert unproven(bodies, motion, pairs, required).tolist() == (gaps < margin).tolist()
    lower = smallest_gaps(bodies, motion, pairs, required)
    assert (lower <= gaps).all() and (gaps - lower <= 0.51e-3)[gaps < margin].all()
    assert (lower >= margin)[gaps > margin].all()


def test_a_safe_pair_is_not_resolved_further_than_its_verdict_needs():
    plane, motion, gaps, _ = _many_discs()
    pairs = [(0, 1 + k) for k in range(12)]
    lower = smallest_gaps(bodies_of(plane), motion, pairs, np.full(12, 0.35))
    # a bound above the level is enough, so that most of the others are far from their gaps
    assert ((gaps - lower)[gaps > 0.6] > 0.01).any()


def test_the_numbers_of_a_certificate_cannot_be_changed():
    plane, motion, _, _ = _many_discs()
    found = certify(plane, motion, Safety())
    for column in vars(found).values():
        assert not column.flags.writeable


def test_obstacles_are_never_unsafe_robots():
    plane = _plane(2, [[5.0, 0.0, 1.0]])
    found = certify(plane, SegmentMotion.at_rest(np.zeros((2, 2))), Safety(), [(0, 2), (1, 2)])
    assert found.unsafe.tolist() == [True, False]
    assert found.unsafe_robots.tolist() == [True, False]
