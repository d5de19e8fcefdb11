"""The decentralized navigation function of Makarem et al. 2014, on tips and on whole arms."""

from fiber_planner.dnf.parameters import DnfParameters
from fiber_planner.dnf.planner import DnfArmsPlanner, DnfPlanner

__all__ = ["DnfArmsPlanner", "DnfParameters", "DnfPlanner"]
