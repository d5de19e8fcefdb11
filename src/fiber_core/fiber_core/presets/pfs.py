# SPDX-License-Identifier: Apache-2.0
"""PFS: cobras on a hexagonal grid, all alike or some of them with narrower windows of phi."""

from dataclasses import replace

import numpy as np

from fiber_core.focal_plane import FocalPlane
from fiber_core.presets.figures import Preset, checked_number, on_a_grid

__all__ = ["PFS", "PFS_WINDOWS"]

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

_LIMITED = 87  # of 2394 cobras: those beside fiducials
_SEED = 2026


def _with_windows(figures: Preset, robots: int | None, name: str) -> FocalPlane:
    n, count = figures.robots, checked_number(figures, robots, name)
    rng = np.random.default_rng(_SEED)
    limited = rng.choice(n, _LIMITED, replace=False)
    unfolding = np.clip(rng.normal(107.4, 33.6, _LIMITED), 60.0, 161.0)  # from folded [deg]
    plane = on_a_grid(figures, count, name)
    limits = np.broadcast_to(plane.limits[0], (n, 2, 2)).copy()
    limits[limited, 1, 0] = np.deg2rad(figures.phi_deg[1] - unfolding)
    return replace(plane, limits=limits[:count])


PFS_WINDOWS = replace(
    PFS,
    build=_with_windows,
    note="As pfs, and 87 of 2394 cobras may unfold phi only by 60 to 161 degrees, as published for "
    "cobras beside fiducials. Inferred: which cobras these are (drawn with one seed, angles from "
    "the statistics), and that the limit holds for every theta; the instrument's holds for some 40 "
    "degrees of theta. Speed assumed: half a turn a second.",
)
