# SPDX-License-Identifier: Apache-2.0
"""A plane of three robots with everything a layout can carry, and a plan's stamp."""

import numpy as np
import pytest

from fiber_core.focal_plane import FocalPlane
from fiber_msgs_py import PlanStamp


@pytest.fixture
def stamp():
    return PlanStamp(1_700_000_000_123_456_789)


@pytest.fixture
def plane():
    return FocalPlane(
        ids=[3, 42, 70_000],
        centers=[[0.1, -10.4], [10.4, 0.0], [1234.5678, 9.0]],
        arms=[[3.0, 3.0], [2.999, 3.063], [8.0, 17.0]],
        limits=[[[-3.4, 3.4], [-0.1, 3.2]]] * 3,
        speeds=[[np.pi, 2.0], [3.07, 3.07], [0.1, 0.2]],
        phi_vertices=[[[3.967, 0.0], [3.269, 1.583], [-1.172, -1.037]]] * 3,
        phi_radius=[0.0, 0.1, 1.6],
        theta_vertices=[[[5.094, 0.54], [-2.007, -2.665]]] * 3,
        theta_radius=[0.0, 0.2, 0.3],
        enabled=[True, False, True],
        obstacles=[[1.0, 2.0, 2.5], [-3.0, 4.0, 0.0]],
        bus=[0, 1, 9],
        address=[1, 1023, 500],
        spacing_mm=4.0,
        envelope_mm=5.0,
    )
