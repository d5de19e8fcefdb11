"""Outlines of robots as closed lines, for figures and for the live view."""

import numpy as np

from fiber_core import kinematics
from fiber_core.focal_plane import FocalPlane

__all__ = ["outlines"]

_CORNERS = 72  # of a full turn: a rounding is drawn to a thousandth of its radius


def outlines(plane: FocalPlane, row: int, angles) -> list[np.ndarray]:
    """Return the outlines of one robot as closed lines [mm], each shape (k, 2), phi link first.

    Args:
        plane: the focal plane.
        row: which robot.
        angles: joint angles of all [rad], shape (n, 2).
    """
    elbow = kinematics.forward(plane, angles)[0]
    theta, both = angles[row, 0], angles[row].sum()
    found = [_outline(plane.phi_vertices[row], plane.phi_radius[row], elbow[row], both)]
    if plane.theta_vertices.shape[1]:
        link = plane.theta_vertices[row], plane.theta_radius[row]
        found.append(_outline(*link, plane.centers[row], theta))
    return found


def _outline(vertices, radius, origin, turn):
    # A convex hull grown by a radius: in the normal direction of each of its points the
    # farthest vertex carries it. Between two directions a corner is cut at most by
    # radius (1 - cos(pi / corners)); a sharp hull's own corners are all among its vertices.
    around = np.linspace(0, 2 * np.pi, _CORNERS + 1)
    normals = np.stack([np.cos(around), np.sin(around)], axis=1)
    farthest = vertices[np.argmax(vertices @ normals.T, axis=0)]
    c, s = np.cos(turn), np.sin(turn)
    return origin + (farthest + radius * normals) @ np.array([[c, s], [-s, c]])
