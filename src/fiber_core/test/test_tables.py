"""Tables are read in every format, real planes among them, and every kind of damage is refused."""

import numpy as np
import pytest
from astropy.table import MaskedColumn, Table

from fiber_core import (
    LayoutError,
    TargetsError,
    inverse,
    preset,
    random_problem,
    read_layout,
    read_obstacles,
    read_targets,
    save_problem,
)
from fiber_core.clearance import neighbour_pairs


def test_the_real_desi_plane(real_planes):
    path = real_planes / "desi_2021-06-25.csv"
    plane = read_layout(path)
    assert plane.n == 5020 and (~plane.enabled).sum() == 829
    raw = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert np.array_equal(plane.ids, raw["location"])
    assert np.array_equal(plane.phi_vertices[:, 1, 0], raw["arm_phi_mm"])
    assert np.allclose(plane.arms, np.stack([raw["arm_theta_mm"], raw["arm_phi_mm"]], axis=1))
    theta, phi = np.moveaxis(np.rad2deg(plane.limits), 1, 0)
    assert np.allclose(theta.mean(axis=1), raw["theta_zero_deg"])
    assert np.allclose(np.diff(theta)[:, 0], raw["theta_range_deg"])
    assert np.allclose(phi[:, 0], raw["phi_zero_deg"])
    assert np.allclose(np.diff(phi)[:, 0], raw["phi_range_deg"])
    together = {}
    for petal, bus, number in zip(raw["petal"], raw["bus"], plane.bus):
        together.setdefault((petal, bus), set()).add(int(number))
    assert sorted(min(numbers) for numbers in together.values()) == list(range(100))
    assert all(len(numbers) == 1 for numbers in together.values())
    assert len(set(zip(plane.bus, plane.address))) == 5020
    assert plane.spacing_mm == 4.0 and np.all(plane.phi_radius == 1.0)


def test_the_real_desi_plane_with_real_outlines(real_planes):
    plane = read_layout(real_planes / "desi_2021-06-25.csv", "desi_outlines")
    assert np.array_equal(plane.phi_vertices[0], preset("desi_outlines", 1).phi_vertices[0])
    assert plane.theta_vertices.shape[1] > 3 and np.all(plane.phi_radius == 0.0)


def test_the_real_sdss_v_plane(real_planes):
    fiducials = real_planes / "sdss_v_fiducials.csv"
    plane = read_layout(real_planes / "sdss_v_positioners.csv", obstacles=fiducials)
    assert plane.n == 501 and np.array_equal(plane.ids, np.arange(501))
    assert plane.obstacles.shape == (60, 3) and np.all(plane.obstacles[:, 2] == 2.5)
    assert np.all(plane.arms == [7.4, 15.0]) and np.all(plane.phi_radius == 2.0)
    assert (neighbour_pairs(plane)[:, 1] >= plane.n).any()


def layout_table(n=9):
    rng = np.random.default_rng(3)
    centers = preset("desi", n).centers
    return Table(
        {
            "id": 10 + 3 * np.arange(n)[::-1],
            "x_mm": centers[:, 0],
            "y_mm": centers[:, 1],
            "arm_theta_mm": rng.normal(3.0, 0.02, n),
            "arm_phi_mm": rng.normal(3.06, 0.02, n),
            "theta_zero_deg": rng.uniform(-180, 500, n),
            "theta_range_deg": rng.uniform(385, 395, n),
            "phi_min_deg": rng.uniform(-5, 5, n),
            "phi_max_deg": rng.uniform(180, 190, n),
            "theta_speed_deg_s": rng.uniform(100, 200, n),
            "enabled": rng.random(n) < 0.7,
            "radius_mm": rng.uniform(0.9, 1.6, n),
            "petal": np.arange(n) // 4,
            "bus": np.array(["can10", "can11"])[np.arange(n) % 2],
        }
    )


def write(table, path):
    kind = {".csv": "ascii.csv", ".ecsv": "ascii.ecsv", ".fits": "fits"}[path.suffix]
    table.write(path, format=kind, overwrite=True)
    return path


@pytest.mark.parametrize("suffix", [".csv", ".ecsv", ".fits"])
def test_every_format_gives_the_same_plane(suffix, tmp_path):
    table = layout_table()
    plane = read_layout(write(table, tmp_path / f"plane{suffix}"))
    order = np.argsort(table["id"])
    assert plane.name == "plane" and np.array_equal(plane.ids, table["id"][order])
    table = table[order]
    assert np.array_equal(plane.centers, np.stack([table["x_mm"], table["y_mm"]], axis=1))
    assert np.array_equal(plane.enabled, table["enabled"])
    assert np.array_equal(plane.phi_radius, table["radius_mm"])
    assert np.array_equal(plane.phi_vertices[:, 1, 0], table["arm_phi_mm"])
    half = table["theta_range_deg"] / 2
    zero = table["theta_zero_deg"]
    expected = [[zero - half, zero + half], [table["phi_min_deg"], table["phi_max_deg"]]]
    assert np.allclose(np.rad2deg(plane.limits), np.moveaxis(np.array(expected), 2, 0))
    assert np.allclose(np.rad2deg(plane.speeds[:, 0]), table["theta_speed_deg_s"])
    assert np.allclose(np.rad2deg(plane.speeds[:, 1]), 176.0)  # from the preset
    assert len(np.unique(plane.bus)) == 6 - 1  # the last of three petals has one robot


@pytest.mark.parametrize("suffix", [".ecsv", ".fits"])
def test_the_unit_of_a_column_is_converted_or_refused(suffix, tmp_path):
    table = layout_table()
    table["x_mm"] = table["x_mm"] / 1000
    table["x_mm"].unit = "m"
    plane = read_layout(write(table, tmp_path / f"metres{suffix}"))
    assert np.allclose(np.sort(plane.centers[:, 0]), np.sort(1000 * np.array(table["x_mm"])))
    table["x_mm"].unit = "s"
    with pytest.raises(LayoutError, match="x_mm"):
        read_layout(write(table, tmp_path / f"seconds{suffix}"))


def test_two_columns_and_a_preset_make_a_plane(tmp_path):
    path = write(layout_table()["x_mm", "y_mm"], tmp_path / "sites.csv")
    usual = preset("pfs", 9)
    plane = read_layout(path, "pfs")
    for name in ("arms", "limits", "speeds", "phi_vertices", "phi_radius", "enabled", "bus"):
        assert np.array_equal(getattr(plane, name), getattr(usual, name)), name
    with pytest.raises(LayoutError, match="no column arm_theta_mm nor arm_phi_mm: name a preset"):
        read_layout(path)
    with pytest.raises(LayoutError, match="keck"):
        read_layout(path, "keck")


def test_a_zero_without_a_range_shifts_the_limits_of_the_preset(tmp_path):
    table = layout_table()["x_mm", "y_mm", "theta_zero_deg"]
    plane = read_layout(write(table, tmp_path / "zeros.csv"), "sdss_v")
    low, high = np.rad2deg(plane.limits[:, 0]).T
    assert np.allclose(low, table["theta_zero_deg"]) and np.allclose(high, low + 360)


def without(name):
    def damage(table):
        table.remove_column(name)

    return damage


def with_value(name, value, row=4):
    def damage(table):
        column = [str(v) for v in table[name]]
        column[row] = value
        table.replace_column(name, column)

    return damage


ROW_4 = "22"  # its id


@pytest.mark.parametrize(
    "damage, words",
    [
        (without("x_mm"), ["no column x_mm"]),
        (with_value("y_mm", "nan"), ["column y_mm", "robot " + ROW_4, "nan"]),
        (with_value("y_mm", ""), ["column y_mm", "robot " + ROW_4]),
        (with_value("y_mm", "here"), ["column y_mm", "robot " + ROW_4, "here"]),
        (with_value("arm_phi_mm", "0.0"), ["robot " + ROW_4, "arms"]),
        (with_value("id", "10"), ["more than one row for robot 10"]),
        (with_value("id", "2.5"), ["column id", "2.5"]),
        (with_value("enabled", "perhaps"), ["column enabled", "robot " + ROW_4, "perhaps"]),
        (with_value("enabled", ""), ["column enabled", "robot " + ROW_4]),
        (with_value("radius_mm", "-1"), ["robot " + ROW_4, "phi_radius", "-1"]),
        (with_value("theta_range_deg", "-5"), ["robot " + ROW_4, "limits"]),
        (with_value("theta_speed_deg_s", "0"), ["robot " + ROW_4, "speeds"]),
        (with_value("bus", ""), ["column bus", "robot " + ROW_4]),
        (without("phi_min_deg"), ["no column phi_min_deg"]),
    ],
)
def test_damage_is_refused_by_file_column_and_robot(damage, words, tmp_path):
    table = layout_table()
    damage(table)
    with pytest.raises(LayoutError) as refusal:
        read_layout(write(table, tmp_path / "damaged.csv"))
    message = str(refusal.value)
    assert "damaged.csv" in message and all(word in message for word in words), message


def test_a_missing_value_of_a_fits_table_is_refused(tmp_path):
    table = layout_table()
    table["x_mm"] = MaskedColumn(table["x_mm"], mask=np.arange(9) == 4)
    with pytest.raises(LayoutError, match=f"column x_mm is not a number: robot {ROW_4}"):
        read_layout(write(table, tmp_path / "masked.fits"))


@pytest.mark.parametrize("name", ["absent.csv", "empty.csv", "noise.fits", "noise.ecsv", "a.xlsx"])
@pytest.mark.parametrize(
    "read, error",
    [(read_layout, LayoutError), (read_obstacles, LayoutError), (read_targets, TargetsError)],
)
def test_a_file_that_is_no_table_is_refused(name, read, error, tmp_path):
    if name != "absent.csv":
        (tmp_path / name).write_bytes(b"" if "empty" in name else bytes(range(256)) * 20)
    with pytest.raises(error, match=name):
        read(tmp_path / name)


def test_a_layout_without_rows_is_refused(tmp_path):
    with pytest.raises(LayoutError, match="no robots"):
        read_layout(write(layout_table()[:0], tmp_path / "none.csv"))


@pytest.mark.parametrize("suffix", [".csv", ".ecsv", ".fits"])
def test_targets_keep_the_order_of_the_file(suffix, tmp_path):
    table = Table({"id": [7, 3, 5], "x_mm": [1.5, -2.0, 3.25], "y_mm": [0.0, 1e-3, 9.0]})
    ids, xy_mm = read_targets(write(table, tmp_path / f"targets{suffix}"))
    assert ids.dtype == np.int64 and np.array_equal(ids, [7, 3, 5])
    assert np.array_equal(xy_mm, [[1.5, 0.0], [-2.0, 1e-3], [3.25, 9.0]])


def test_targets_of_a_problem_file_are_read(tmp_path):
    asked = np.arange(20) % 4 != 0
    problem = random_problem(preset("desi", 20), np.random.default_rng(0), asked=asked)
    save_problem(tmp_path / "problem.npz", problem)
    ids, xy_mm = read_targets(tmp_path / "problem.npz")
    assert np.array_equal(ids, np.flatnonzero(asked))
    assert np.array_equal(xy_mm, problem.targets[asked])
    _, valid = inverse(problem.plane, problem.targets)
    assert np.array_equal(valid.any(axis=1), asked)
    (tmp_path / "torn.npz").write_bytes(b"no")
    with pytest.raises(TargetsError, match="torn.npz"):
        read_targets(tmp_path / "torn.npz")


def test_bad_targets_are_refused_by_robot(tmp_path):
    table = Table({"id": [7, 3, 5], "x_mm": ["1.5", "nan", "3"], "y_mm": [0.0, 1e-3, 9.0]})
    with pytest.raises(TargetsError, match="column x_mm is not a number: robot 3: nan"):
        read_targets(write(table, tmp_path / "targets.csv"))
    with pytest.raises(TargetsError, match="no column id"):
        read_targets(write(table["x_mm", "y_mm"], tmp_path / "no_ids.csv"))
