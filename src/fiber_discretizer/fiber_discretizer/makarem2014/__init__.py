# SPDX-License-Identifier: Apache-2.0
"""The discretization of Makarem et al. (2014), arXiv 1410.1181, with its errata corrected."""

from fiber_discretizer.makarem2014.seven_steps import discretize_makarem2014
from fiber_discretizer.makarem2014.share import (
    joint_shares,
    lever_arms_mm,
    tip_distances_mm,
)

__all__ = [
    "discretize_makarem2014",
    "joint_shares",
    "lever_arms_mm",
    "tip_distances_mm",
]
