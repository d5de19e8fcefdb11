# SPDX-License-Identifier: Apache-2.0
"""Problems from files, and random ones where files do not give everything."""

import numpy as np
import pytest

from fiber_core.fields import random_problem
from fiber_core.presets import preset
from fiber_core.problem import save_problem
from fiber_formats import FormatError, problem_from


def test_a_problem_comes_from_an_instrument_with_its_seed():
    first, again, other = (problem_from(robots=19, seed=seed).problem for seed in (4, 4, 5))
    assert first.plane.name == "desi" and first.plane.n == 19
    np.testing.assert_array_equal(first.targets, again.targets)
    assert not np.array_equal(first.start, other.start)
    usual = random_problem(preset("desi", 19), np.random.default_rng(4))
    np.testing.assert_array_equal(first.start, usual.start)


def test_layout_and_starts_of_one_file_and_targets_of_another(made_up, tmp_path):
    state = made_up / "desi_state.ecsv"
    (tmp_path / "targets.csv").write_text("id,x_mm,y_mm\n3001,201,101\n9001,,\n77,1,2\n")
    found = problem_from(layout=state, starts=state, targets=tmp_path / "targets.csv")
    assert found.problem.asked.tolist() == [True] + 5 * [False]
    assert found.lines[0].startswith("desi_state.ecsv: 6 robots, 2 disabled")
    assert "desi_state.ecsv: present angles of 6 robots" in found.lines
    assert "targets.csv: 2 targets, 1 robots without target" in found.lines
    assert found.lines[-1] == "not in the plane: robot 77, 1 rows"


def test_targets_are_random_where_no_file_gives_them(made_up):
    state = made_up / "desi_state.ecsv"
    found = problem_from(layout=state, starts=state, seed=3).problem
    assert found.asked.tolist() == found.plane.enabled.tolist()
    idle = problem_from(layout=state, starts=state, random_targets=False).problem
    assert not idle.asked.any() and np.array_equal(idle.start, found.start)


def test_a_problem_file_lends_what_no_other_file_gives(tmp_path):
    problem = random_problem(preset("desi", 7), np.random.default_rng(1))
    save_problem(tmp_path / "problem.npz", problem)
    same = problem_from(tmp_path / "problem.npz")
    assert np.array_equal(same.problem.targets, problem.targets) and same.lines == ()
    (tmp_path / "targets.csv").write_text("id,x_mm,y_mm\n3,1,2\n")
    other = problem_from(tmp_path / "problem.npz", targets=tmp_path / "targets.csv").problem
    assert np.array_equal(other.start, problem.start) and other.asked.sum() == 1


def test_a_file_that_is_refused_is_named(tmp_path):
    with pytest.raises(FormatError, match="there is no file .*missing.csv"):
        problem_from(layout=tmp_path / "missing.csv")


def test_a_spacing_stands_before_that_of_the_plane(tmp_path):
    assert problem_from(robots=7).problem.plane.spacing_mm == 0.0
    asked = problem_from(robots=7, spacing_mm=6.0).problem.plane
    assert (asked.spacing_mm, asked.envelope_mm) == (6.0, 4.0)
    save_problem(tmp_path / "problem.npz", problem_from(robots=7, spacing_mm=6.0).problem)
    assert problem_from(tmp_path / "problem.npz").problem.plane.spacing_mm == 6.0
    assert problem_from(tmp_path / "problem.npz", spacing_mm=0.0).problem.plane.spacing_mm == 0.0
