# SPDX-License-Identifier: Apache-2.0
"""The bus bridge as a ROS node."""

from fiber_bus_bridge.node.bridge import BridgeNode, main

__all__ = ["BridgeNode", "main"]
