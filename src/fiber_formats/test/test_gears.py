# SPDX-License-Identifier: Apache-2.0
"""Gears that couple motors and joints, in tables of own columns and from a preset."""

import numpy as np
import pytest

from fiber_core.presets import preset
from fiber_formats import FormatError, convert, read_layout
from fiber_formats.formats.own import GEARS, MOTOR_LIMITS, MOTOR_SPEEDS

PLANE = preset("spec_s5", 63)


def table(folder, *groups, first=PLANE.coupling[0], robots=63):
    """Write robots of Spec-S5 with some groups of columns; the first robot has gears of its own."""
    gears = PLANE.coupling.copy()
    gears[0] = first
    values = {
        GEARS: gears.reshape(-1, 4),
        MOTOR_SPEEDS: np.rad2deg(PLANE.motor_speeds),
        MOTOR_LIMITS: np.rad2deg(PLANE.motor_limits).reshape(-1, 4),
    }
    names = [name for group in groups for name in group]
    head = ["id", "x_mm", "y_mm", "arm_theta_mm", "arm_phi_mm", *names]
    rows = [
        [k, *PLANE.centers[k].tolist(), 1.8, 1.8, *(v for g in groups for v in values[g][k])]
        for k in range(robots)
    ]
    path = folder / "own.csv"
    path.write_text("\n".join(",".join(map(str, row)) for row in [head, *rows]) + "\n")
    return path


def test_a_table_holds_gears_with_speeds_and_ranges_of_motors(tmp_path):
    path = table(tmp_path, GEARS, MOTOR_SPEEDS, MOTOR_LIMITS, first=[[1.0, 0.0], [0.5, 2.0]])
    layout = read_layout(path, "spec_s5")
    assert layout.notices == () and "gears" not in layout.summary
    assert layout.plane.coupling[0].tolist() == [[1.0, 0.0], [0.5, 2.0]]
    for name in ("coupling", "motor_speeds", "motor_limits"):
        assert np.allclose(getattr(layout.plane, name)[1:], getattr(PLANE, name)[1:]), name


@pytest.mark.parametrize("suffix", [".csv", ".ecsv", ".fits"])
def test_converted_gears_are_the_same(tmp_path, suffix):
    path = table(tmp_path, GEARS, MOTOR_SPEEDS, MOTOR_LIMITS)
    convert(path, tmp_path / f"again{suffix}", "must")
    first, second = read_layout(path, "must").plane, read_layout(tmp_path / f"again{suffix}").plane
    for name in ("coupling", "motor_speeds", "motor_limits"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name


def test_gears_without_more_let_the_motors_do_what_the_joints_allow(tmp_path):
    plane = read_layout(table(tmp_path, GEARS), "spec_s5").plane
    most = (np.abs(plane.coupling) * plane.speeds[:, None]).sum(axis=2)
    assert np.array_equal(plane.motor_speeds, most)


def test_gears_of_a_preset_are_supplied_and_named(tmp_path):
    # joints that are coupled in truth would otherwise drive a motor over its limit
    layout = read_layout(table(tmp_path), "spec_s5")
    assert "speeds, gears, outlines" in layout.summary
    assert np.array_equal(layout.plane.coupling, PLANE.coupling)
    assert np.array_equal(layout.plane.motor_speeds, PLANE.motor_speeds)
    assert read_layout(table(tmp_path), "must").plane.coupling.shape == (63, 0, 2)


@pytest.mark.parametrize(
    "groups, lacking",
    [
        ([GEARS[:3]], "motor_2_by_phi"),
        ([GEARS, MOTOR_SPEEDS[:1]], "motor_2_speed_deg_s"),
        ([GEARS, MOTOR_LIMITS[1:]], "motor_1_min_deg"),
        ([MOTOR_SPEEDS], ", ".join(GEARS)),
    ],
)
def test_a_part_of_the_columns_is_refused_with_those_that_lack(tmp_path, groups, lacking):
    path = tmp_path / "own.csv"
    names = [name for group in groups for name in group]
    path.write_text(f"id,x_mm,y_mm,{','.join(names)}\n1,0,0{',1' * len(names)}\n")
    with pytest.raises(FormatError, match=f"no column {lacking};"):
        read_layout(path, "spec_s5")


def test_gears_that_do_not_hold_the_joints_are_refused_by_robot(tmp_path):
    path = table(tmp_path, GEARS, first=[[1.0, 1.0], [2.0, 2.0]])
    with pytest.raises(FormatError, match="robot 0: coupling must have an inverse"):
        read_layout(path, "spec_s5")
