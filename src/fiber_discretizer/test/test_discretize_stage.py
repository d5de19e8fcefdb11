# SPDX-License-Identifier: Apache-2.0
"""The discretization stage: robots outside the trajectory rest, the first reason is kept."""

import numpy as np
import pytest

from fiber_core.clearance import Safety
from fiber_core.errors import MotionError
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireUnits
from fiber_discretizer import discretize, discretize_trajectory

UNITS, SAFETY = WireUnits(), Safety()
START = UNITS.to_angles(UNITS.to_counts(np.tile([-0.5, 0.3], (3, 1))))


@pytest.fixture
def plane(plane_at):
    return plane_at([[0.0, 0.0], [40.0, 0.0], [80.0, 0.0]])


def turning(robots):
    goal = START[robots] + [1.0, 0.5]
    return SampledMotion([0.0, 2.0], np.stack([START[robots], goal], axis=-1))


def test_the_orders_are_those_of_discretize(plane):
    result = discretize_trajectory(plane, START, plane.ids, turning([0, 1, 2]), UNITS, SAFETY)
    wire = discretize(plane, turning([0, 1, 2]), UNITS, SAFETY).wire
    for name in ("start", "offsets", "ticks", "velocity"):
        np.testing.assert_array_equal(
            getattr(result.discretization.wire, name), getattr(wire, name)
        )
    assert result.reason.tolist() == [Reason.OK] * 3 and not result.held.any()


def test_robots_outside_the_trajectory_rest(plane):
    velocities = np.full((1, 2, 2), 0.5)
    result = discretize_trajectory(
        plane, START, plane.ids[1:2], turning([1]), UNITS, SAFETY, velocities=velocities
    )
    moves = result.discretization.wire.decoded().counts.any(axis=1)
    assert moves.tolist() == [False, True, False]


def test_the_reason_of_an_earlier_stage_is_kept(plane):
    motion = turning([0, 1, 2])
    elsewhere = START.copy()
    elsewhere[:2, 0] += 0.1
    earlier = [Reason.NOT_CONVERGED, Reason.OK, Reason.NO_TARGET]
    result = discretize_trajectory(
        plane, elsewhere, plane.ids, motion, UNITS, SAFETY, earlier=earlier
    )
    assert result.reason.tolist() == [Reason.NOT_CONVERGED, Reason.BAD_TRAJECTORY, Reason.OK]
    assert result.held.tolist() == [True, True, False]
    own = result.discretization.reason
    assert own.tolist() == [Reason.BAD_TRAJECTORY, Reason.BAD_TRAJECTORY, Reason.OK]


def test_a_robot_of_another_plane_is_named(plane):
    with pytest.raises(MotionError, match="robot 7 of the trajectory is not in the layout"):
        discretize_trajectory(plane, START, [7], turning([0]), UNITS, SAFETY)
