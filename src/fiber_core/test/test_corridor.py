"""Margins are walls that fit each other, or are refused by row."""

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
        ([1.0, -1.0], LOW, LOW, "lasts -1.0 s"),
        ([1.0, 1.0], LOW + [[[0.0]], [[2.0]]], LOW + 1, "row 1: the low wall is above"),
        ([1.0, 1.0], LOW, LOW + np.nan, "high holds nan"),
        ([1.0, 1.0], LOW, LOW[:, :, 1:], "walls have shapes"),
        ([1.0, 1.0], LOW[:, :, :1], LOW[:, :, :1], "walls have shapes"),
    ],
)
def test_what_is_no_margin_is_refused(lasts, low, high, words):
    with pytest.raises(MotionError, match=words):
        JointCorridors(lasts, low, high)
