"""The base of all nodes of the graph: its namespace, and the parameters that it was given."""

import os
from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from fiber_node.parameters import NodeParameters

__all__ = ["PlaneNode"]


class PlaneNode(Node):
    """A node of the graph of one focal plane.

    It is in the namespace of the environment variable ROS_NAMESPACE, unless a namespace is given
    or remapped. `parameters` declares its parameters.

    Args:
        name: name of the node.
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, name: str, **options: Any):
        options.setdefault("namespace", os.environ.get("ROS_NAMESPACE", ""))
        # declared as they were given, so that `parameters` can name the unknown ones
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **options)
        self.parameters = NodeParameters(self)

    def declare_parameters(
        self, namespace: str, parameters: Sequence[Any], ignore_override: bool = False
    ) -> list[Any]:
        """Declare parameters, as rclpy does; one whose value has no type may get any."""
        # rclpy refuses an empty list of a parameter file, whose type is not known
        typed: list[Any] = [
            (entry[0], None, ParameterDescriptor(dynamic_typing=True))
            if len(entry) > 1 and entry[1] is None
            else entry
            for entry in parameters
        ]
        return super().declare_parameters(namespace, typed, ignore_override)
