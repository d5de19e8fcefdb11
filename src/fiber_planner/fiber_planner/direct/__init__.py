# SPDX-License-Identifier: Apache-2.0
"""The direct planner: straight motions at full speed, and local search for robots in conflict."""

from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.pieces import straight_pieces
from fiber_planner.direct.planner import DirectPlanner
from fiber_planner.direct.reachability import reachable

__all__ = ["DirectParameters", "DirectPlanner", "reachable", "straight_pieces"]
