"""The decentralized navigation function of Makarem et al. 2014, on tips and on whole arms."""

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
