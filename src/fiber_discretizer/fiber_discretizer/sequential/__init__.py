# SPDX-License-Identifier: Apache-2.0
"""Sequential discretization: robot after robot, each with all the space that the others leave.

`search` has the order in which robots are discretized, `candidates` the motions that each
robot can select from, `selection` the choice of the shortest safe one, `segment_plan` the
segments of all robots with the pairs that are not proven safe.
"""

from fiber_discretizer.sequential.search import discretize_sequentially

__all__ = ["discretize_sequentially"]
