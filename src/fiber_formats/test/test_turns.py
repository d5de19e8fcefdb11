# SPDX-License-Identifier: Apache-2.0
"""Present angles that differ from a layout's ranges by whole turns."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_formats import read_layout, read_starts
from fiber_formats.turns import on_a_turn_inside

LIMITS = np.deg2rad(np.array([[[-196.0, 196.0], [0.0, 190.0]]]))


def read(tmp_path, angles, theta=(-196, 196)):
    head = "id,x_mm,y_mm,theta_min_deg,theta_max_deg,phi_min_deg,phi_max_deg\n"
    rows = [f"{k},{10.4 * k},0,{theta[0]},{theta[1]},0,190\n" for k in range(len(angles))]
    (tmp_path / "own.csv").write_text(head + "".join(rows))
    rows = [f"{k},{t},{p}\n" for k, (t, p) in enumerate(angles)]
    (tmp_path / "starts.csv").write_text("id,theta_deg,phi_deg\n" + "".join(rows))
    return read_starts(tmp_path / "starts.csv", read_layout(tmp_path / "own.csv", "desi").plane)


def test_an_angle_is_moved_by_the_only_number_of_turns_that_fits(tmp_path):
    found = read(tmp_path, [(350, 90), (-20, 450), (10, 90)])
    assert np.allclose(np.rad2deg(found.angles), [[-10, 90], [-20, 90], [10, 90]])
    assert found.notices == (
        "starts moved by whole turns into the joint ranges, 2 robots: robot 0, 1",
    )


def test_angles_that_fit_on_two_turns_are_named(tmp_path):
    found = read(tmp_path, [(350, 90), (-540, 90), (175, 90), (10, 90)])
    assert np.allclose(np.rad2deg(found.angles[1:]), [[-540, 90], [175, 90], [10, 90]])
    text = "\n".join(found.notices)
    assert "starts that fit on two turns, taken as they stand, 1 robots: robot 2" in text
    assert "starts that fit on several turns, none taken: robot 1" in text
    assert "starts outside the joint ranges, so held: robot 1" in text


def test_angles_inside_the_ranges_of_their_own_layout_are_not_spoken_of(tmp_path):
    assert read(tmp_path, [(175, 90), (-190, 0)]).notices == ()


@pytest.mark.parametrize("angle", [200.0, -250.0])
def test_an_angle_that_fits_on_no_turn_is_left_and_named(tmp_path, angle):
    found = read(tmp_path, [(angle, 90)], theta=(-100, 100))
    assert np.allclose(np.rad2deg(found.angles), [[angle, 90]])
    assert found.notices == ("starts outside the joint ranges, so held: robot 0",)


@given(theta=st.floats(-60, 60), phi=st.floats(-60, 60))
def test_the_pose_never_changes(theta, phi):
    angles = np.array([[theta, phi]])
    turned = on_a_turn_inside(angles, LIMITS, 0.0)
    whole = (turned.angles - angles) / (2 * np.pi)
    assert np.allclose(whole, np.rint(whole), atol=1e-9)
    inside = (turned.angles >= LIMITS[:, :, 0]) & (turned.angles <= LIMITS[:, :, 1])
    assert inside[:, 1].all() == (phi % (2 * np.pi) <= LIMITS[0, 1, 1])
    assert inside[0, 0] or turned.unclear[0]
