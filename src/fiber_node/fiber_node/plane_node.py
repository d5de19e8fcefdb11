# SPDX-License-Identifier: Apache-2.0
"""The base of all nodes of the graph: its namespace, and the parameters that it was given."""

import os
import time
from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from fiber_node.parameters import NodeParameters
from fiber_node.signs_of_life import SignsOfLife
from fiber_node.worker import Worker

__all__ = ["PlaneNode"]


_WORK_ENDS_S = 0.5  # longest wait for work that was cancelled


class PlaneNode(Node):
    """A node of the graph of one focal plane.

    It is in the namespace of the environment variable ROS_NAMESPACE, unless a namespace is given
    or remapped. `parameters` declares its parameters. `ended` tells, once the node is destroyed,
    whether the work of its workers has ended too.

    Args:
        name: name of the node.
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, name: str, **options: Any):
        options.setdefault("namespace", os.environ.get("ROS_NAMESPACE", ""))
        options.setdefault("enable_logger_service", True)  # the level can change while it runs
        # declared as they were given, so that `parameters` can name the unknown ones
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **options)
        self.parameters = NodeParameters(self)
        self._workers: list[Worker] = []
        self.ended = True

    def pause(self, seconds: float) -> None:
        """Sleep for a while in a wait that may take long.

        Raises:
            KeyboardInterrupt: the process was told to end; rclpy does not say so by itself when it
                is told by SIGTERM.
        """
        if not self.context.ok():
            raise KeyboardInterrupt
        time.sleep(seconds)

    def worker(self, name: str) -> Worker:
        """Return a new worker, whose work is cancelled when the node is destroyed."""
        self._workers.append(Worker(self, name))
        return self._workers[-1]

    def end_workers(self) -> None:
        """Cancel the work of all workers, and wait for its end, half a second at most for each."""
        self._workers = [each for each in self._workers if not each.close(_WORK_ENDS_S)]

    def destroy_node(self) -> None:
        """Cancel the work of all workers, and give up the node."""
        self.end_workers()
        self.ended = not self._workers
        SignsOfLife.of(self).end()
        super().destroy_node()

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Set parameters, all or none, as rclpy does; an unknown one is refused by its name."""
        # the answer of rclpy does not say which one it is
        unknown = [each.name for each in parameter_list if not self.has_parameter(each.name)]
        if unknown:
            reason = "; ".join(map(self.parameters.missing, unknown))
            self.get_logger().warning(f"parameter change refused: {reason}")
            return SetParametersResult(successful=False, reason=reason)
        return super().set_parameters_atomically(parameter_list)

    def declare_parameters(
        self, namespace: str, parameters: Sequence[Any], ignore_override: bool = False
    ) -> list[Any]:
        """Declare parameters, as rclpy does; one whose value has no type may get any."""
        # rclpy refuses an empty list of a parameter file, whose type is not known
        for entry in parameters:
            if len(entry) > 2 and entry[1] is None:
                entry[2].dynamic_typing = True
        return super().declare_parameters(namespace, list(parameters), ignore_override)
