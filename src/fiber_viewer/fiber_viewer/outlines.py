# SPDX-License-Identifier: Apache-2.0
"""Outlines of robots as closed lines, for figures and for the live view."""

import numpy as np
from numpy.typing import ArrayLike

from fiber_core import kinematics
from fiber_core.array_types import Floats, Points
from fiber_core.focal_plane import FocalPlane

__all__ = ["outlines"]

_CORNERS = 72  # of a circle: a rounding is drawn to a thousandth of its radius


def outlines(plane: FocalPlane, row: int, angles: ArrayLike) -> list[Points]:
    """Return the outlines of one robot as closed lines [mm], each shape (k, 2), phi arm first.

    Args:
        plane: the focal plane.
        row: row of the robot.
        angles: joint angles of all robots [rad], shape (n, 2).
    """
    angles = np.asarray(angles, dtype=float)
    elbow = kinematics.forward(plane, angles)[0]
    theta, both = angles[row, 0], angles[row].sum()
    found = [_outline(plane.phi_vertices[row], plane.phi_radius[row], elbow[row], both)]
    if plane.theta_vertices.shape[1]:
        link = plane.theta_vertices[row], plane.theta_radius[row]
        found.append(_outline(*link, plane.centers[row], theta))
    return found


def _outline(vertices: Points, radius: float, origin: Floats, turn: float) -> Points:
    # A convex polygon grown by a radius: the boundary point with normal direction u is the
    # vertex that is farthest in direction u, plus radius * u. Between two sampled directions
    # the line cuts off at most radius (1 - cos(pi / corners)).
    around = np.linspace(0, 2 * np.pi, _CORNERS + 1)
    normals = np.stack([np.cos(around), np.sin(around)], axis=1)
    farthest = vertices[np.argmax(vertices @ normals.T, axis=0)]
    c, s = np.cos(turn), np.sin(turn)
    return origin + (farthest + radius * normals) @ np.array([[c, s], [-s, c]])
