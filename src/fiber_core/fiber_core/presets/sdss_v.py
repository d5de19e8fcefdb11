# SPDX-License-Identifier: Apache-2.0
"""SDSS-V: robots whose arms reach over their neighbours, on a hexagon."""

from fiber_core.presets.figures import Polygon, Preset

__all__ = ["CAMERA_MM", "SDSS_V"]

# A guide camera in its own frame [mm]: x along its front, y away from the centre of the wok. The
# planner of SDSS-V (sdss/kaiju) keeps arms
# 3 mm from a line of 113.08 mm, 51.32 mm before its place.
CAMERA_MM: Polygon = ((-59.54, -54.32), (59.54, -54.32), (59.54, 0.0), (-59.54, 0.0))

SDSS_V = Preset(
    robots=547,
    pitch_mm=22.4,
    arms_mm=(7.4, 15.0),
    theta_deg=(0.0, 360.0),
    phi_deg=(0.0, 180.0),
    speeds_deg_s=(12.0, 12.0),
    envelope_mm=8.0,
    radius_mm=2.0,
    hexagon=True,
    note="Speed as its own planner uses it. The full hexagon of 547 sites, of which the "
    "instrument fills 500. Envelope chosen: four radii.",
)
