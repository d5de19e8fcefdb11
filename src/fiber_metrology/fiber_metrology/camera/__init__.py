# SPDX-License-Identifier: Apache-2.0
"""The simulated fibre-view camera."""

from fiber_metrology.camera.fiducial_places import fiducial_places
from fiber_metrology.camera.simulated_camera import (
    CameraConfig,
    Exposure,
    Photograph,
    SimulatedCamera,
)
from fiber_metrology.camera.turbulence import turbulence

__all__ = [
    "CameraConfig",
    "Exposure",
    "Photograph",
    "SimulatedCamera",
    "fiducial_places",
    "turbulence",
]
