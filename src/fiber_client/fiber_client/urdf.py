# SPDX-License-Identifier: Apache-2.0
"""The description of one robot as a URDF: links, joints with limits, and boxes for its arms."""

import xml.etree.ElementTree as ET

import numpy as np

from fiber_core.array_types import Points
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_msgs_py.joints import joint_names

__all__ = ["robot_urdf"]

_MM = 1e-3  # URDF is in metres
_THICK_MM, _THIN_MM = 1.0, 0.2  # of the boxes, and of an arm without an outline
_COLORS = {"theta": "0.3 0.4 0.5 1", "phi": "0.9 0.6 0.0 1"}


def robot_urdf(plane: FocalPlane, robot: int, frame: str) -> str:
    """Return the URDF of a robot, whose root is the frame of the plane.

    Joints have the names that they have in joint states, so that `robot_state_publisher` follows
    those. The frames `pNNNN/base`, `pNNNN/theta_arm`, `pNNNN/phi_arm` and `pNNNN/tip` are in the
    namespace of the frame of the plane. Arms are shown as boxes round their outlines, the phi arm
    above the theta arm, as it is built; angles and places are those of the plane.

    Args:
        plane: the focal plane.
        robot: id of the robot.
        frame: frame of the plane, as "focal_plane" or "north/focal_plane".

    Raises:
        FiberError: the plane has no such robot.
    """
    (row,) = plane.index_of(np.array([robot]))
    if row < 0:
        raise FiberError(f"robot {robot} has no description: the plane has no such robot")
    theta, phi = joint_names([robot], "urdf")
    name = theta.rpartition("/")[0]
    place = frame.rpartition("/")[0]
    parts = {part: f"{place}/{name}/{part}".lstrip("/") for part in ("base", "tip")}
    arms = {arm: f"{place}/{name}/{arm}_arm".lstrip("/") for arm in ("theta", "phi")}
    root = ET.Element("robot", name=name)
    for link in (frame, parts["base"]):
        ET.SubElement(root, "link", name=link)
    l1, l2 = plane.arms[row]
    for k, (arm, length, vertices, radius) in enumerate((
        ("theta", l1, plane.theta_vertices[row], plane.theta_radius[row]),
        ("phi", l2, plane.phi_vertices[row], plane.phi_radius[row]),
    )):  # fmt: skip
        low, high = _box(length, vertices, float(radius))
        _link(root, arms[arm], low, high, k, _COLORS[arm])
    ET.SubElement(root, "link", name=parts["tip"])
    x, y = plane.centers[row]
    _joint(root, f"{name}/mount", "fixed", frame, parts["base"], (x, y))
    for k, (joint, parent, child, origin) in enumerate((
        (theta, parts["base"], arms["theta"], (0.0, 0.0)),
        (phi, arms["theta"], arms["phi"], (l1, 0.0)),
    )):  # fmt: skip
        made = _joint(root, joint, "revolute", parent, child, origin)
        ET.SubElement(made, "axis", xyz="0 0 1")
        low, high = plane.limits[row, k]
        speed = plane.speeds[row, k]
        ET.SubElement(
            made, "limit", lower=_text(low), upper=_text(high), velocity=_text(speed), effort="0"
        )
    _joint(root, f"{name}/end", "fixed", arms["phi"], parts["tip"], (l2, 0.0))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _box(length: float, vertices: Points, radius: float) -> tuple[Points, Points]:
    """Corners of the box round an outline, in the frame of its link [mm], each of shape (2,)."""
    if len(vertices) == 0:
        return np.array([0.0, -_THIN_MM / 2]), np.array([length, _THIN_MM / 2])
    return vertices.min(axis=0) - radius, vertices.max(axis=0) + radius


def _link(root: ET.Element, name: str, low: Points, high: Points, layer: int, color: str) -> None:
    visual = ET.SubElement(ET.SubElement(root, "link", name=name), "visual")
    middle = [*((low + high) / 2 * _MM), layer * _THICK_MM * _MM]
    ET.SubElement(visual, "origin", xyz=_text(*middle), rpy="0 0 0")
    size = _text(*((high - low) * _MM), _THICK_MM * _MM)
    ET.SubElement(ET.SubElement(visual, "geometry"), "box", size=size)
    material = ET.SubElement(visual, "material", name=f"{name}/color")
    ET.SubElement(material, "color", rgba=color)


def _joint(
    root: ET.Element, name: str, kind: str, parent: str, child: str, origin: tuple[float, float]
) -> ET.Element:
    joint = ET.SubElement(root, "joint", name=name, type=kind)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_text(origin[0] * _MM, origin[1] * _MM, 0.0), rpy="0 0 0")
    return joint


def _text(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)
