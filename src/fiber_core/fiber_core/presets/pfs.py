# SPDX-License-Identifier: Apache-2.0
"""PFS: cobras on a hexagonal grid."""

from fiber_core.presets.figures import Preset

__all__ = ["PFS"]

PFS = Preset(
    robots=2394,
    pitch_mm=8.0,
    arms_mm=(2.375, 2.375),
    theta_deg=(-192.5, 192.5),
    phi_deg=(0.0, 180.0),
    speeds_deg_s=(180.0, 180.0),
    envelope_mm=4.0,
    radius_mm=1.0,
    note="Speed assumed, none is published: half a turn a second, so that times read as "
    "half turns. Envelope as in the papers.",
)
