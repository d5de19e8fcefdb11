# SPDX-License-Identifier: Apache-2.0
"""A client of the focal-plane graph: it sends targets, starts the plan and reads the outcome."""

from fiber_client.client import PlaneClient
from fiber_client.disable import DisabledRobots
from fiber_client.errors import NodeLost, PlaneError, PlaneRefusal
from fiber_client.terminal import ProgressDisplay

__all__ = [
    "DisabledRobots",
    "NodeLost",
    "PlaneClient",
    "PlaneError",
    "PlaneRefusal",
    "ProgressDisplay",
]
