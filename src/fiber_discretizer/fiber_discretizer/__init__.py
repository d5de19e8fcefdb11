# SPDX-License-Identifier: Apache-2.0
"""The discretizer: from planned trajectories to certified orders in whole wire units."""

from fiber_discretizer.discretize import Discretization, discretize
from fiber_discretizer.discretize_stage import DiscretizeStageResult, discretize_trajectory
from fiber_discretizer.errors import UnknownOption
from fiber_discretizer.fit import LINEARIZERS, Polylines, linearize
from fiber_discretizer.joint_corridors import joint_corridors
from fiber_discretizer.makarem2014 import joint_shares, lever_arms_mm, tip_distances_mm
from fiber_discretizer.options import RULES, SHARINGS, DiscretizeOptions
from fiber_discretizer.quantize import Rounding, quantize

__all__ = [
    "LINEARIZERS",
    "RULES",
    "SHARINGS",
    "Discretization",
    "DiscretizeOptions",
    "DiscretizeStageResult",
    "Polylines",
    "Rounding",
    "UnknownOption",
    "discretize",
    "discretize_trajectory",
    "joint_corridors",
    "joint_shares",
    "lever_arms_mm",
    "linearize",
    "quantize",
    "tip_distances_mm",
]
