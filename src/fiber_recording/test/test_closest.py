# SPDX-License-Identifier: Apache-2.0
"""Closest approaches are found, and none is closer than the bound of the certificate."""

import numpy as np
import pytest

from fiber_core.clearance import Safety, certify, gaps, neighbour_pairs
from fiber_core.motion import SegmentMotion
from fiber_core.presets import preset
from fiber_recording import closest_approaches


def test_every_pair_is_listed_once_closest_first(recording):
    plane, found = recording.problem.plane, recording.approaches
    assert (np.diff(found.gap_mm) >= 0).all()
    pairs = found.pairs[np.lexsort(found.pairs.T[::-1])]
    np.testing.assert_array_equal(pairs, neighbour_pairs(plane))


def test_a_gap_is_that_at_its_time(recording):
    plane, found = recording.problem.plane, recording.approaches
    for at in range(0, len(found.pairs), 7):
        angles = recording.executed(found.time_s[at])
        assert gaps(plane, found.pairs[at : at + 1], angles)[0] == pytest.approx(found.gap_mm[at])


def test_the_closest_approach_agrees_with_the_certificate():
    # one robot turns past another robot that rests
    plane = preset("desi", 7)
    start = np.tile([0.0, 2.5], (7, 1))
    start[0] = [0.0, 0.0]
    offsets = np.concatenate([[0, 1], np.full(13, 1)])
    motion = SegmentMotion(start, offsets, [1.0], [2.0])
    certificate = certify(plane, motion, Safety())
    found = closest_approaches(plane, motion, 0.004)
    near = found.gap_mm[0]
    assert certificate.min_gap_mm <= near <= certificate.min_gap_mm + 2e-3
    assert tuple(found.pairs[0]) == certificate.min_pair


def test_a_plane_with_one_robot_has_no_pairs():
    plane = preset("desi", 1)
    found = closest_approaches(plane, SegmentMotion.at_rest(np.zeros((1, 2))), 0.004)
    assert len(found.pairs) == 0
