"""From planned trajectories to certified orders in whole wire units."""

from fiber_discretizer.discretize import Discretization, discretize
from fiber_discretizer.fit.linearize import LINEARIZERS, Polylines, UnknownOption, linearize
from fiber_discretizer.joint_corridors import joint_corridors
from fiber_discretizer.makarem2014.margin import (
    RULES,
    joint_margins,
    lever_arms_mm,
    tip_distances_mm,
)
from fiber_discretizer.options import DiscretizeOptions
from fiber_discretizer.quantize import Rounding, quantize
from fiber_discretizer.segments import Segments

__all__ = [
    "LINEARIZERS",
    "RULES",
    "Discretization",
    "DiscretizeOptions",
    "Polylines",
    "Rounding",
    "Segments",
    "UnknownOption",
    "discretize",
    "joint_corridors",
    "joint_margins",
    "lever_arms_mm",
    "linearize",
    "quantize",
    "tip_distances_mm",
]
