# SPDX-License-Identifier: Apache-2.0
"""Coordinator and sectors as ROS nodes."""

from fiber_sectors.node.coordinator import CoordinatorNode
from fiber_sectors.node.sector_node import SectorNode

__all__ = ["CoordinatorNode", "SectorNode"]
