# SPDX-License-Identifier: Apache-2.0
"""The table of the bench of real motors names the goals that fields miss."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
from motors_table import table_of  # noqa: E402

LINE = {
    "row": "blind", "seed": 0, "asked": 1000, "reached": 996, "reachable_at_once": 1000,
    "lower_bound_s": 5.0, "supply_bound_s": 5.5, "power_bound_s": 5.5, "certified": True,
    "drive_violations": 0,
    "segments_mean": 5.0, "bytes_mean": 34.0, "cpu_s": 5.0, "makespan_s": 6.0, "peak": 0.55,
    "violations": 0, "contacts": 0, "near": 0, "least_gap_mm": 0.05, "end_error_um": 0.8,
}  # fmt: skip


def goals(*lines):
    """The last cell of the row of these lines."""
    return table_of(list(lines)).splitlines()[2].split(" | ")[-1].removesuffix(" |")


def test_goals_that_hold():
    assert goals(LINE) == goals(LINE, LINE | {"seed": 1}) == "hold"


@pytest.mark.parametrize(
    ("values", "missed"),
    [
        ({"reached": 994}, "share 99.5 %"),
        ({"makespan_s": 6.4}, "ratio 1.15"),
        ({"cpu_s": 11.0}, "time 10.0 s"),
        ({"contacts": 1}, "rules and contacts"),
        ({"violations": 1}, "rules and contacts"),
        ({"drive_violations": 1}, "rules and contacts"),
        ({"certified": False}, "rules and contacts"),
    ],
)
def test_one_field_that_misses_a_goal_is_enough(values, missed):
    assert goals(LINE, LINE | {"seed": 1} | values) == f"missed: {missed}"


def test_the_shortest_time_of_corrections_and_segments_are_goals():
    assert goals(LINE | {"row": "corrections", "makespan_s": 5.01}) == "missed: 5.0 s"
    ramps = LINE | {"row": "accelerated", "makespan_s": 5.1, "true_contacts": 0, "reached": 1000}
    ramps |= {"simulated_moves": 0, "segments_mean": 1.1}
    assert goals(ramps) == "hold"
    assert goals(ramps | {"segments_mean": 1.2}) == "missed: segments"
    assert goals(ramps | {"true_contacts": 1}) == "missed: rules and contacts"


def test_pairs_that_are_near_are_told_apart_from_contacts():
    lines = table_of([LINE | {"near": 3}, LINE | {"seed": 1, "near": 4}]).splitlines()
    cells = dict(zip(lines[0].split(" | "), lines[2].split(" | ")))
    assert (cells["contacts"], cells["near"]) == ("0", "7")
    assert cells["bounds [s], median: alone, motor time over cap"] == "5.000, 5.500"


LINEAR = {
    "row": "linear", "seed": 0, "linear": 490, "linear_asked": 490, "linear_ordered": 460,
    "draws": 20, "linear_rms_um": 52.0, "of_one_draw_um": [48.5, 57.4], "others_rms_um": 53.0,
    "parts_um": {"scale": 48.0, "speed": 20.0}, "contacts": 0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("other", "rms", "goal"),
    [
        ({"linear_rms_um": 55.0}, "53.5 (48.5 to 57.4)", "holds"),
        ({"linear_rms_um": 56.5}, "54.3 (48.5 to 57.4)", "missed"),
        ({"contacts": 1}, "52.0 (48.5 to 57.4)", "missed"),
    ],
)
def test_errors_of_linear_robots_are_those_of_all_fields_and_draws(other, rms, goal):
    cells = table_of([LINEAR, LINEAR | {"seed": 1} | other]).splitlines()[-1].split(" | ")
    assert cells[5] == rms and cells[6] == "48.0, 20.0"
    assert cells[-1].removesuffix(" |") == goal
