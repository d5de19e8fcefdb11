# SPDX-License-Identifier: Apache-2.0
"""Point clouds for 3D viewers: points in metres, with the state and the colour of their robots."""

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.outcomes import Outcome
from fiber_msgs_py import PlanStamp, topics
from fiber_msgs_py.point_clouds import (
    POINTS,
    ViewState,
    arms_cloud,
    plane_cloud,
    points_cloud,
    view_states,
)
from fiber_msgs_py.table import decode_table, encode_table

ANGLES = np.array([[0.3, 1.0], [-2.0, 0.5], [1.0, 3.0]])


def metres(rows):
    return np.stack([rows["x"], rows["y"]], axis=1)


def test_arms_run_from_centre_to_elbow_and_from_elbow_to_tip(plane):
    states = np.array([ViewState.MOVING, ViewState.DISABLED, ViewState.HELD])
    rows = arms_cloud(plane, ANGLES, states)
    elbow, tip = kinematics.forward(plane, ANGLES)
    theta, phi = metres(rows).reshape(2, plane.n, POINTS, 2)
    for arm, begin, end in ((theta, plane.centers, elbow), (phi, elbow, tip)):
        np.testing.assert_allclose(arm[:, 0], begin / 1e3, rtol=1e-6)
        np.testing.assert_allclose(arm[:, -1], end / 1e3, rtol=1e-6)
        np.testing.assert_allclose(np.diff(arm, n=2, axis=1), 0, atol=1e-6)
    per_robot = rows.reshape(2, plane.n, POINTS)
    assert (per_robot["state"] == states[:, None]).all() and not rows["z"].any()


def test_the_plane_has_a_point_for_each_centre_and_each_obstacle(plane):
    rows = plane_cloud(plane)
    xy_mm = np.concatenate([plane.centers, plane.obstacles[:, :2]])
    np.testing.assert_allclose(metres(rows), xy_mm / 1e3, rtol=1e-6)
    resting, disabled = ViewState.RESTING, ViewState.DISABLED
    assert rows["state"].tolist() == [resting, disabled, resting, disabled, disabled]


def test_targets_are_points_of_one_state():
    rows = points_cloud([[1500.0, -2.0], [0.0, 4.0]], ViewState.REACHED)
    np.testing.assert_allclose(metres(rows), [[1.5, -0.002], [0.0, 0.004]], rtol=1e-6)
    assert (rows["state"] == ViewState.REACHED).all()
    assert len(points_cloud(np.zeros((0, 2)), ViewState.REACHED)) == 0


@pytest.mark.parametrize(
    ("moving", "outcome", "expected"),
    [
        ([False, False, False], None, ["RESTING", "DISABLED", "RESTING"]),
        ([True, True, False], None, ["MOVING", "DISABLED", "RESTING"]),
        (
            [False, False, True],
            [Outcome.HELD, Outcome.REACHED, Outcome.FAILED],
            ["HELD", "DISABLED", "MOVING"],
        ),
        (
            [False, False, False],
            [Outcome.REACHED, Outcome.HELD, Outcome.FAILED],
            ["REACHED", "DISABLED", "FAILED"],
        ),
    ],
)
def test_disabled_comes_before_moving_and_moving_before_the_outcome(
    plane, moving, outcome, expected
):
    states = view_states(plane, np.array(moving), outcome)
    assert [ViewState(state).name for state in states] == expected


def test_every_state_has_its_own_colour():
    colours = {int(points_cloud([[0.0, 0.0]], state)["rgb"][0]) for state in ViewState}
    assert len(colours) == len(ViewState)


def test_a_cloud_travels_as_a_table():
    sent = points_cloud([[1.0, 2.0]], ViewState.HELD)
    message = encode_table(sent, PlanStamp(5))
    columns = {"x": "<f4", "y": "<f4", "z": "<f4", "state": "<f4", "rgb": "<u4"}
    np.testing.assert_array_equal(decode_table(message, "view/targets", columns), sent)
    assert isinstance(message, topics.VIEW_TARGETS.type)
