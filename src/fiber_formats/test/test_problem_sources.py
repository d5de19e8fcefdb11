# SPDX-License-Identifier: Apache-2.0
"""A problem comes from a problem file, a layout table or a preset."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import FiberError, preset, random_problem, save_problem
from fiber_core.drive import Drive
from fiber_formats import DEFAULT_PRESET, problem_from


def write_layout(path, arms_mm=(2.375, 2.375)):
    # seven robots on the grid of PFS
    x, y = preset("pfs", 7).centers.T
    lines = [f"{x},{y},{arms_mm[0]},{arms_mm[1]}" for x, y in zip(x, y)]
    path.write_text("\n".join(["x_mm,y_mm,arm_theta_mm,arm_phi_mm", *lines]))
    return path


def test_a_problem_comes_from_an_instrument_with_its_seed():
    first, same, other = (problem_from(robots=19, seed=seed).problem for seed in (4, 4, 5))
    assert first.plane.name == DEFAULT_PRESET == "desi" and first.plane.n == 19
    np.testing.assert_array_equal(first.targets, same.targets)
    assert not np.array_equal(first.start, other.start)


def test_a_preset_has_its_own_number_of_robots_by_default():
    problem = problem_from(preset="sdss_v", seed=1).problem
    assert problem.plane.name == "sdss_v" and problem.plane.n == preset("sdss_v").n
    expected = random_problem(preset("sdss_v"), np.random.default_rng(1))
    np.testing.assert_array_equal(problem.targets, expected.targets)


def test_a_layout_gives_the_plane_and_its_arms_give_the_preset(tmp_path):
    problem = problem_from(layout=write_layout(tmp_path / "plane.csv"), seed=2).problem
    pfs = preset("pfs", 7)
    assert problem.plane.name == "plane" and problem.plane.n == 7
    np.testing.assert_allclose(problem.plane.speeds, pfs.speeds)
    np.testing.assert_allclose(problem.plane.centers, pfs.centers)


def test_a_preset_supplies_the_missing_columns_of_a_layout(tmp_path):
    layout = write_layout(tmp_path / "plane.csv")
    problem = problem_from(layout=layout, preset="sdss_v").problem
    np.testing.assert_allclose(problem.plane.speeds, preset("sdss_v", 7).speeds)


def test_a_problem_file_is_read_and_all_else_ignored(tmp_path):
    saved = random_problem(preset("pfs", 7), np.random.default_rng(3))
    save_problem(tmp_path / "problem.npz", saved)
    problem = problem_from(tmp_path / "problem.npz", preset="moons", robots=61, seed=9).problem
    assert problem.plane.name == "pfs"
    np.testing.assert_array_equal(problem.start, saved.start)
    np.testing.assert_array_equal(problem.targets, saved.targets)


@pytest.mark.parametrize(
    "source, words",
    [
        ({"preset": "keck"}, "no preset is named 'keck'"),
        ({"preset": "pfs", "robots": -1}, "robots must be a positive integer, got -1"),
        ({"problem": "torn.npz"}, "torn.npz is not a problem or plan file"),
        ({"layout": "torn.txt"}, "torn.txt: no column x_mm, y_mm; it has no"),
    ],
)
def test_a_bad_source_is_refused(source, words, tmp_path):
    paths = {name: tmp_path / source[name] for name in source if name in ("problem", "layout")}
    for path in paths.values():
        path.write_bytes(b"no")
    with pytest.raises(FiberError, match=words):
        problem_from(**(source | paths))


def test_a_share_of_motors_alone_leaves_the_motors_as_the_file_says(tmp_path):
    plane = preset("desi", 7)
    own = replace(plane, drive=Drive(7, ramp_s=0.1, acceleration_rad_s2=30.0))
    problem = random_problem(own, np.random.default_rng(1))
    save_problem(tmp_path / "problem.npz", problem)
    found = problem_from(problem=tmp_path / "problem.npz", motors_on=0.5).problem.plane.drive
    assert (found.ramp_s, found.motors_on) == (0.1, 0.5)
    np.testing.assert_array_equal(found.acceleration_rad_s2, own.drive.acceleration_rad_s2)


def test_a_figure_of_a_drive_out_of_range_is_refused_with_the_id_of_the_robot(tmp_path):
    problem = random_problem(preset("desi", 5), np.random.default_rng(1))
    plane = replace(problem.plane, ids=np.arange(40, 45), drive=Drive(5, supply=np.zeros(5)))
    save_problem(tmp_path / "problem.npz", replace(problem, plane=plane))
    data = dict(np.load(tmp_path / "problem.npz"))
    data["motor_scale"][3] = 0.001
    np.savez(tmp_path / "problem.npz", **data)
    with pytest.raises(FiberError, match=r"robot 43: scale must be 0.01 to 100, got"):
        problem_from(problem=tmp_path / "problem.npz")
    table = "id,x_mm,y_mm,theta_scale_falling\n7,0,0,1\n4,12,0,-1\n"
    (tmp_path / "plane.csv").write_text(table)
    with pytest.raises(FiberError, match=r"plane.csv: robot 4: scale must be 0.01 to 100, got"):
        problem_from(layout=tmp_path / "plane.csv", preset="desi")


def test_a_supply_that_may_feed_less_than_one_motor_is_refused_by_name(tmp_path):
    plane = preset("desi", 5)
    told = r"supply 0: 0.05 of its 10 motors is 0.5, and less than one motor moves no robot"
    with pytest.raises(FiberError, match=told):
        problem_from(preset="desi", robots=5, motors_on=0.05)
    capped = replace(plane, drive=Drive(5, supply=np.zeros(5), motors_on=0.05))
    save_problem(tmp_path / "problem.npz", random_problem(capped, np.random.default_rng(1)))
    with pytest.raises(FiberError, match=told):
        problem_from(problem=tmp_path / "problem.npz")
