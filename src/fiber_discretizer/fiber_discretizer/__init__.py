"""From planned trajectories to certified orders in whole wire units."""

from fiber_discretizer.discretize import Discretization, discretize
from fiber_discretizer.linearize import LINEARIZERS, Polylines, UnknownOption, linearize
from fiber_discretizer.margin import RULES, joint_margins, lever_arms_mm, tip_distances_mm
from fiber_discretizer.options import DiscretizeOptions
from fiber_discretizer.quantize import Rounding, quantize
from fiber_discretizer.segments import Segments
from fiber_discretizer.sent_margins import sent_margins

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
    "joint_margins",
    "lever_arms_mm",
    "linearize",
    "quantize",
    "sent_margins",
    "tip_distances_mm",
]
