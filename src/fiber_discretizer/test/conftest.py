# SPDX-License-Identifier: Apache-2.0
"""Shared by the tests of this package: the settings of properties and small synthetic planes."""

import numpy as np
import pytest
from hypothesis import settings

from fiber_core.focal_plane import FocalPlane

# New draws in every run: a law holds for all of them, and a failure prints how to repeat it.
settings.register_profile("laws", derandomize=False, database=None, deadline=None, print_blob=True)
settings.load_profile("laws")


def _plane(centers, **columns):
    centers = np.asarray(centers, dtype=float)
    n = len(centers)
    capsule = np.zeros((n, 2, 2))
    capsule[:, 1, 0] = 3.0
    return FocalPlane(
        **{
            "ids": 100 + np.arange(n),
            "centers": centers,
            "arms": np.full((n, 2), 3.0),
            "limits": np.tile([[-5.0, 5.0], [0.0, np.pi]], (n, 1, 1)),
            "speeds": np.full((n, 2), np.pi),
            "phi_vertices": capsule,
            "phi_radius": np.ones(n),
            "theta_vertices": np.zeros((n, 0, 2)),
            "theta_radius": np.zeros(n),
            "enabled": np.ones(n, dtype=bool),
            **columns,
        }
    )


@pytest.fixture(scope="session")
def plane_at():
    """Function that builds DESI-like robots (capsules of 1 mm, arms 3 + 3 mm) at centres [mm]."""
    return _plane
