# SPDX-License-Identifier: Apache-2.0
"""Starts the node graph of a focal plane: in one process, as processes, or with ros2 launch."""

from fiber_bringup.errors import ProcessError
from fiber_bringup.graph import Graph
from fiber_bringup.processes import Processes, installed

__all__ = ["Graph", "ProcessError", "Processes", "installed"]
