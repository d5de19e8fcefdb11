# SPDX-License-Identifier: Apache-2.0
"""The command that measures sectors fails when a promise is broken."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

GOOD = {
    "start_skew_ms_max": 0.03, "start_skew_bound_ms": 0.14, "contacts": 0, "unverified": 0,
    "without_outcome": 0,
}  # fmt: skip


@pytest.fixture(scope="module")
def sectors():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[1] / "bench")
        import sectors

        yield sectors


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("contacts", 1, ["contacts"]),
        ("unverified", 1, ["unverified"]),
        ("without_outcome", 1, ["without_outcome"]),
        ("start_skew_ms_max", 0.2, ["start_skew"]),
        ("start_skew_ms_max", math.nan, ["start_skew"]),
        ("contacts", 0, []),
    ],
)
def test_each_broken_promise_ends_the_command_with_an_error(
    sectors, monkeypatch, capsys, name, value, found
):
    monkeypatch.setattr(sectors, "_measure", lambda args: GOOD | {name: value})
    assert sectors.main([]) == bool(found)
    assert json.loads(capsys.readouterr().out)["broken"] == found


def test_what_lies_beyond_an_order_is_no_part_of_it(sectors):
    from fiber_bus_bridge.simulation import Movements

    ticks = np.array([[[100, 50], [80, 70]]] * 2)
    counts = np.array([[1, 1], [2, 1]])  # the first order has one segment a joint
    moves = Movements(
        np.arange(2), np.zeros(2), np.full(2, 0.4), np.full(2, 4e-3), counts, ticks, ticks
    )
    np.testing.assert_array_equal(sectors.broken_off(moves, 9.0), [False, True])


@pytest.mark.parametrize("late_s", [0.0, 1e-3, 6e-3, 0.5])
def test_a_sector_that_starts_late_is_late_in_its_start_by_any_time(sectors, late_s):
    # six robots start twice, of which the last two are late in the second start
    begun = [(0.0, robot) for robot in range(6)]
    begun += [(3.0, robot) for robot in range(4)] + [(3.0 + late_s, robot) for robot in (4, 5)]
    started_s, row = np.array(sorted(begun)).T
    of = sectors.starts_of(row.astype(int))
    assert of.tolist() == [0] * 6 + [1] * 6
    assert np.ptp(started_s[of == 1]) == pytest.approx(late_s)
