# SPDX-License-Identifier: Apache-2.0
"""Corridors have bounds of one shape, the low bound below the high bound; others are refused."""

import numpy as np
import pytest

from fiber_core.corridor import JointCorridors
from fiber_core.errors import MotionError

LOW = np.zeros((2, 2, 4))


def test_instants_are_equally_spaced_over_each_motion():
    corridors = JointCorridors([0.0, 3.0], LOW, LOW + 1)
    assert len(corridors) == 2
    assert corridors.times_s(1).tolist() == [0.0, 1.0, 2.0, 3.0]
    assert corridors.times_s(0).tolist() == [0.0] * 4


@pytest.mark.parametrize(
    ("lasts", "low", "high", "words"),
    [
        ([1.0], LOW, LOW, "low has shape"),
        ([1.0, -1.0], LOW, LOW, "lasts_s must be 0 or more, got -1.0"),
        ([1.0, 1.0], LOW + [[[0.0]], [[2.0]]], LOW + 1, "row 1: the low bound is above"),
        ([1.0, 1.0], LOW, LOW + np.nan, "high must be finite, but holds nan"),
        ([1.0, 1.0], LOW, LOW[:, :, 1:], "bounds must have the same shape"),
        ([1.0, 1.0], LOW[:, :, :1], LOW[:, :, :1], "bounds must have the same shape"),
    ],
)
def test_walls_that_are_no_corridor_are_refused(lasts, low, high, words):
    with pytest.raises(MotionError, match=words):
        JointCorridors(lasts, low, high)
