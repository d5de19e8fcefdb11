# SPDX-License-Identifier: Apache-2.0
"""DESI: robots on a plain hexagonal grid, and the keep-out polygons of its robots."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Floats
from fiber_core.convex_parts import convex_hull
from fiber_core.presets.figures import Polygon, Preset

__all__ = ["DESI", "DESI_OUTLINES", "LINEAR_DEG", "keepouts"]

LINEAR_DEG = 5.0  # keep-outs of a linear phi motor are wider by this, at least

# DESI-0899, in the frame of the link [mm].
_PHI_ARM: Polygon = (
    (3.967, 0.000), (3.918, 1.014), (3.269, 1.583), (-1.172, 1.037),
    (-1.172, -1.037), (3.269, -1.583), (3.918, -1.014),
)  # fmt: skip
_THETA_BODY: Polygon = (
    (0.814, -3.236), (2.083, -2.707), (2.613, -2.665), (4.154, -2.759), (4.695, -1.680),
    (5.094, -0.540), (5.094, 0.540), (4.831, 1.291), (4.235, 1.933), (3.432, 2.283),
    (2.280, 2.283), (-1.902, -0.935), (-2.007, -2.665), (-1.139, -3.137), (-0.170, -3.332),
)  # fmt: skip

DESI = Preset(
    robots=5000,
    pitch_mm=10.4,
    arms_mm=(3.0, 3.0),
    theta_deg=(-194.0, 194.0),
    phi_deg=(0.0, 180.0),
    speeds_deg_s=(176.0, 176.0),
    envelope_mm=4.0,
    radius_mm=1.0,
    note="A capsule of 1 mm in place of the real outlines, and a plain hexagonal grid in "
    "place of ten petals. Joint ranges are the narrow end of the real ones.",
)

DESI_OUTLINES = replace(
    DESI,
    radius_mm=0.0,
    phi_outline=_PHI_ARM,
    theta_outline=_THETA_BODY,
    note="Outlines of DESI-0899; the theta body is replaced by its convex hull. Plain "
    "hexagonal grid, no petal edges.",
)


def keepouts(
    arms: Floats,
    theta_mm: ArrayLike = 0.0,
    theta_deg: ArrayLike = 0.0,
    phi_mm: ArrayLike = 0.0,
    phi_deg: ArrayLike = 0.0,
) -> tuple[Floats, Floats]:
    """Return the outlines of robots as DESI's own collision check expands them.

    A radial expansion moves each corner away from the axis, an angular one away from the arm's
    centre line on both sides. The front of the phi arm shifts with the lengths of the arms
    beyond their nominal 3 mm; a shorter phi arm does not shorten it. Rule and corners: the
    keep-outs that desihub/fpoffline derives from a calibration.

    Args:
        arms: lengths of both arms [mm], shape (n, 2).
        theta_mm: radial expansion of the theta body [mm], a number or shape (n,).
        theta_deg: its angular expansion [deg], a number or shape (n,).
        phi_mm: radial expansion of the phi arm [mm], a number or shape (n,).
        phi_deg: its angular expansion [deg], a number or shape (n,).

    Returns:
        Vertices of the theta bodies and of the phi arms [mm], shapes (n, m, 2) and (n, 7, 2).
    """
    n = len(arms)
    phi = _expanded(_PHI_ARM, n, phi_mm, phi_deg)
    front = arms[:, 0] - DESI.arms_mm[0] + np.maximum(arms[:, 1] - DESI.arms_mm[1], 0.0)
    phi[:, :, 0] += np.where(phi[:, :, 0] > 0.0, front[:, None], 0.0)
    kinds = np.stack([np.broadcast_to(v, n) for v in (theta_mm, theta_deg)], axis=1)
    kinds, kind = np.unique(kinds.astype(float), axis=0, return_inverse=True)
    hulls = [convex_hull(body) for body in _expanded(_THETA_BODY, len(kinds), *kinds.T)]
    most = max((len(hull) for hull in hulls), default=1)
    hulls = [hull[np.minimum(np.arange(most), len(hull) - 1)] for hull in hulls]
    return np.array(hulls).reshape(-1, most, 2)[kind.reshape(-1)], phi


def _expanded(polygon: Polygon, n: int, radial: ArrayLike, angular: ArrayLike) -> Floats:
    x, y = np.array(polygon).T
    radius = np.hypot(x, y) + np.broadcast_to(radial, n)[:, None]
    angle = np.arctan2(y, x)
    angle = angle + np.sign(angle) * np.deg2rad(np.broadcast_to(angular, n))[:, None]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=2)
