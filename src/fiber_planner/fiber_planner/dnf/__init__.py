# SPDX-License-Identifier: Apache-2.0
"""The dnf planners: the decentralized navigation function of Makarem et al. 2014."""

from fiber_planner.dnf.parameters import DnfParameters, DnfPriorityParameters
from fiber_planner.dnf.planner import (
    DnfArmsPlanner,
    DnfArmsPriorityPlanner,
    DnfPlanner,
    DnfPriorityPlanner,
)

__all__ = [
    "DnfArmsPlanner",
    "DnfArmsPriorityPlanner",
    "DnfParameters",
    "DnfPlanner",
    "DnfPriorityParameters",
    "DnfPriorityPlanner",
]
