# SPDX-License-Identifier: Apache-2.0
"""Motors in a table of our own columns: a named drive, or accelerations of each robot."""

import numpy as np
import pytest
from astropy.table import Table

from fiber_core import WireUnits, with_drive
from fiber_core.presets import preset
from fiber_formats import FormatError, convert, read_layout


def layout_table(n=9):
    centers = preset("desi", n).centers
    columns = {"id": 10 + 3 * np.arange(n)[::-1], "x_mm": centers[:, 0], "y_mm": centers[:, 1]}
    return Table(columns | {"arm_theta_mm": np.full(n, 3.0), "arm_phi_mm": np.full(n, 3.0)})


def write(table, path):
    table.write(path, overwrite=True)
    return path


def test_the_drive_is_a_column_and_the_same_for_all_robots(tmp_path):
    table = layout_table()
    assert read_layout(write(table, tmp_path / "plane.csv")).plane.drive.is_ideal
    table["drive"], table["motors_on"] = "desi", 0.5
    plane = read_layout(write(table, tmp_path / "motors.ecsv")).plane
    ideal = read_layout(tmp_path / "plane.csv").plane
    assert plane.drive == with_drive(ideal, "desi", 0.5).drive
    convert(tmp_path / "motors.ecsv", tmp_path / "again.csv")
    assert read_layout(tmp_path / "again.csv").plane.drive == plane.drive
    table["drive"] = ["desi"] * (len(table) - 1) + ["desy"]
    with pytest.raises(FormatError, match="column drive names several: desi, desy"):
        read_layout(write(table, tmp_path / "mixed.csv"))
    table["drive"] = "desy"
    with pytest.raises(FormatError, match="no drive is named 'desy'; there are ideal"):
        read_layout(write(table, tmp_path / "unknown.csv"))


def test_each_motor_has_its_acceleration(tmp_path):
    table = layout_table()
    rows = np.arange(len(table))
    table["theta_acceleration_deg_s2"] = 1000.0 + rows
    table["theta_acceleration_deg_s2"].unit = "deg / s2"
    plane = read_layout(write(table, tmp_path / "plane.ecsv")).plane
    drive, by_id = plane.drive, np.argsort(table["id"])
    assert np.allclose(np.rad2deg(drive.acceleration_rad_s2[:, 0]), 1000.0 + rows[by_id])
    assert np.isinf(drive.acceleration_rad_s2[:, 1]).all() and drive.name == "own"
    # the slowest motor comes to full speed within one ramp, to a tick
    rise_s = (plane.speeds[:, 0] / drive.acceleration_rad_s2[:, 0]).max()
    assert rise_s <= drive.ramp_s < rise_s + WireUnits.for_plane(plane).tick_s
    convert(tmp_path / "plane.ecsv", tmp_path / "again.fits")
    assert read_layout(tmp_path / "again.fits").plane.drive == drive
    table["drive"] = "desi"
    told = "columns drive and theta_acceleration_deg_s2: one of them is meant"
    with pytest.raises(FormatError, match=told):
        read_layout(write(table, tmp_path / "both.ecsv"))


@pytest.mark.parametrize("value", [0.0, -5.0, 1e-3])
def test_an_acceleration_that_gives_no_speed_is_refused_by_robot(tmp_path, value):
    table = layout_table()
    table["phi_acceleration_deg_s2"] = 2000.0
    table["phi_acceleration_deg_s2"][4] = value
    told = rf"robot {table['id'][4]}: accelerations must be above 0 and give full speed within 60 s"
    with pytest.raises(FormatError, match=told):
        read_layout(write(table, tmp_path / "slow.csv"))
