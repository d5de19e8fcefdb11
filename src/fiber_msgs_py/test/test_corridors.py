# SPDX-License-Identifier: Apache-2.0
"""Corridors: bounds come back in single precision, and impossible corridors are refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.corridor import JointCorridors
from fiber_msgs_py import MessageError, PlanStamp, corridors
from fiber_msgs_py.table import encode_table


def drawn(robots, instants, seed):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-7, 0, (robots, 2, instants))
    return JointCorridors(rng.uniform(0, 40, robots), low, low + rng.uniform(0, 3, low.shape))


@given(st.sets(st.integers(0, 2**32 - 1), max_size=8), st.integers(2, 30), st.integers(0, 99))
def test_round_trip_in_single_precision(ids, instants, seed):
    sent = drawn(len(ids), instants, seed)
    message = corridors.encode(sorted(ids), sent, PlanStamp(3))
    got, read = corridors.decode(message)
    assert got.tolist() == sorted(ids) and PlanStamp.of(message) == PlanStamp(3)
    for name in ("lasts_s", "low", "high"):
        np.testing.assert_allclose(getattr(read, name), getattr(sent, name), rtol=1e-7, atol=1e-7)


def test_five_thousand_robots_are_two_megabytes(stamp):
    message = corridors.encode(np.arange(5000), drawn(5000, 25, 0), stamp)
    assert len(message.data) == 5000 * (8 + 4 * 25 * 4) < 2.1e6


def table(stamp, **changed):
    message = corridors.encode([4, 9], drawn(2, 3, 1), stamp)
    names = [field.name for field in message.fields]
    rows = np.frombuffer(
        message.data, [(n, t, () if n in ("id", "lasts") else (3,)) for n, t in
                       zip(names, ["<u4"] + ["<f4"] * 5)],
    )  # fmt: skip
    columns = {name: rows[name].copy() for name in names}
    for name, value in changed.items():
        if value is None:
            del columns[name]
        else:
            columns[name] = np.asarray(value)
    kinds = [(name, value.dtype.str, value.shape[1:]) for name, value in columns.items()]
    rows = np.empty(2, kinds)
    for name, value in columns.items():
        rows[name] = value
    return encode_table(rows, stamp)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"phi_low": None}, "phi_low is missing"),
        ({"phi_low": np.zeros((2, 4), "<f4")}, r"bounds of \[3, 4\]"),
        ({"theta_low": np.full((2, 3), 99, "<f4")}, "row 0: the low bound is above"),
        ({"lasts": np.array([-1, 2], "<f4")}, "lasts_s must be 0 or more, got -1.0"),
        ({"phi_high": np.full((2, 3), np.nan, "<f4")}, "nan"),
        ({"id": np.array([4, 4], "<u4")}, "robot 4: id 4 appears twice"),
    ],
)
def test_impossible_corridors_are_refused(stamp, changed, words):
    with pytest.raises(MessageError, match=words):
        corridors.decode(table(stamp, **changed))


def test_ids_and_corridors_must_agree_in_number(stamp):
    with pytest.raises(MessageError, match="2 robots, but 3 ids"):
        corridors.encode([1, 2, 3], drawn(2, 3, 0), stamp)
