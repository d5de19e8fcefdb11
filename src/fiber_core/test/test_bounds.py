# SPDX-License-Identifier: Apache-2.0
"""Input values out of bounds are refused by name, and inside the bounds all computations end."""

from dataclasses import fields, replace

import numpy as np
import pytest

from fiber_core import (
    FiberError,
    FocalPlane,
    LayoutError,
    MotionError,
    Problem,
    SampledMotion,
    WireUnits,
    assign,
    forward,
    hexagonal,
    preset,
)
from fiber_core.clearance import Safety, neighbour_pairs

NUMBERS = ("spacing_mm", "envelope_mm")
EXTREMES = (0.0, -1.0, np.nan, np.inf, -np.inf, 1e-300, 1e12, 1e25, 2.0**63, "many", None)
OTHER = ("name", "enabled", "drive", "fibre_names")
COLUMNS = [f.name for f in fields(FocalPlane) if f.name not in OTHER]


def plane_with_every_column() -> FocalPlane:
    plane = preset("desi_outlines", 7)
    return replace(
        plane,
        obstacles=[[60.0, 0.0, 1.0]],
        walls=[[[60.0, 9.0], [61.0, 9.0], [61.0, 10.0]]],
        fibres=np.tile([[2.9, 0.1], [3.0, 0.0]], (plane.n, 1, 1)),
        coupling=np.tile([[1.0, 0.0], [-1.5, 1.5]], (plane.n, 1, 1)),
    )


@pytest.mark.parametrize("extreme", EXTREMES, ids=str)
@pytest.mark.parametrize("column", COLUMNS)
def test_a_layout_with_an_extreme_value_works_or_is_refused(column, extreme):
    plane = plane_with_every_column()
    rng = np.random.default_rng(COLUMNS.index(column))
    value = extreme
    if column not in NUMBERS:
        given = np.array(getattr(plane, column), dtype=object if extreme is None else None)
        given = given.astype(object)
        given[tuple(rng.integers(given.shape))] = extreme
        number = isinstance(extreme, float)
        value = given.astype(float) if number else given
    try:
        changed = replace(plane, **{column: value})
    except LayoutError as error:
        assert (
            column in NUMBERS
            or "robot" in str(error)
            or column in str(error)
            or ("obstacle" in str(error))
            or "wall" in str(error)
        )
        return
    start = np.zeros((7, 2))
    assign(changed, start, changed.ids, forward(changed, start + 0.5)[1])
    neighbour_pairs(changed, 1.0)
    units = WireUnits.for_plane(changed)
    assert np.abs(units.encoder_counts(changed, start)).max() < 2**31


@pytest.mark.parametrize(
    "column, row, message",
    [
        ("limits", [[0.0, 1e25], [0.0, 1.0]], "robot 3: limits must be -100.531 to 100.531"),
        ("speeds", [1e-9, 1.0], "robot 3: speeds must be 1e-06 to 10000 rad/s"),
        ("arms", [3.0, 1e12], "robot 3: arms must be 0.001 to 10000 mm"),
        ("centers", [0.0, 1e25], "robot 3: centers must be -1e[+]06 to 1e[+]06 mm"),
        ("phi_radius", 1e12, "robot 3: phi_radius must be 0 to 10000 mm"),
    ],
)
def test_a_layout_out_of_bounds_is_refused_with_robot_value_and_range(column, row, message):
    plane = preset("desi", 7)
    changed = getattr(plane, column).copy()
    changed[3] = row
    with pytest.raises(LayoutError, match=message):
        replace(plane, **{column: changed})


def test_a_start_out_of_bounds_is_refused_with_its_robot():
    plane = preset("desi", 3)
    with pytest.raises(LayoutError, match="robot 1: start must be -201.062 to 201.062 rad"):
        Problem(plane, [[0.0, 0.0], [0.0, 1e25], [0.0, 0.0]], np.full((3, 2), np.nan))


def test_a_trajectory_with_an_angle_out_of_bounds_is_refused():
    with pytest.raises(MotionError, match="robot row 1: angles must be .* got -1e[+]25 rad"):
        SampledMotion([0.0, 1.0], [[[0.0, 0.0]] * 2, [[0.0, -1e25]] * 2])


@pytest.mark.parametrize("robots", [1e12, 2**63, 1e25, np.inf, 100_001])
def test_an_absurd_number_of_robots_is_refused_at_once(robots):
    with pytest.raises(LayoutError, match="robots"):
        preset("desi", robots)
    with pytest.raises(LayoutError, match="robots"):
        hexagonal(robots, 12.0, (3.0, 3.0))


@pytest.mark.parametrize("config", [Safety, WireUnits])
@pytest.mark.parametrize("extreme", EXTREMES, ids=str)
def test_an_extreme_parameter_works_or_is_refused_by_name(config, extreme):
    for field in fields(config):
        try:
            config(**{field.name: extreme})
        except FiberError as error:
            assert field.name in str(error)
        else:
            assert extreme in (0.0, 1e-300)


@pytest.mark.parametrize("speed", [1e-6, 1e-4, 1e-2, 1.0, 1e2, 1e4])
def test_every_angle_in_bounds_fits_the_encoder_at_every_speed(speed):
    plane = preset("desi", 3)
    units = WireUnits.for_plane(replace(plane, speeds=np.full((3, 2), speed)))
    assert np.abs(units.to_counts(201.0)) < 2**31
    assert units.max_velocity * units.velocity_rad_s >= speed


def test_a_fixed_joint_has_one_encoder_count():
    plane, units = preset("desi", 3), WireUnits()
    limits = plane.limits.copy()
    limits[1, 1] = 1.2345678
    plane = replace(plane, limits=limits)
    low, high = units.range_counts(plane)[1, 1]
    assert low == high == units.to_counts(1.2345678)
    start = np.full((3, 2), 1.2345678)
    assert units.encoder_counts(plane, start)[1, 1] == low
    seen = units.to_angles(units.encoder_counts(plane, start))
    pinned = plane.with_fixed_joints_at(seen)
    assert (pinned.limits[1, 1] == seen[1, 1]).all()
    assert np.array_equal(np.delete(pinned.limits, 1, 0), np.delete(plane.limits, 1, 0))
    elsewhere = plane.with_fixed_joints_at(seen + 0.1)
    assert elsewhere is plane
