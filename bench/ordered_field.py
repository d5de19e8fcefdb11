"""A random field with its orders, for what is measured of buses and not of planners."""

from dataclasses import dataclass

import numpy as np

from fiber_core.assignment import assign
from fiber_core.clearance import Safety
from fiber_core.fields import random_problem
from fiber_core.focal_plane import FocalPlane
from fiber_core.problem import Problem
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer import discretize
from fiber_planner import DEFAULT_PLANNER, make_planner

__all__ = ["OrderedField", "ordered_field"]


@dataclass(frozen=True, eq=False)
class OrderedField:
    """Where robots are, where they should go, and the orders that take them there.

    Args:
        plane: the focal plane.
        units: tick, quantum and widths.
        counts: what encoders read [quanta], shape (n, 2).
        wire: the orders.
        targets: what was asked [mm], shape (n, 2).
    """

    plane: FocalPlane
    units: WireUnits
    counts: np.ndarray
    wire: WireMotion
    targets: np.ndarray


def ordered_field(plane: FocalPlane, rng: np.random.Generator) -> OrderedField:
    """Return a random field of a plane, planned and discretized as by default."""
    problem = random_problem(plane, rng)
    units = WireUnits.for_plane(plane)
    counts = units.encoder_counts(plane, problem.start)
    start, asked = units.to_angles(counts), problem.asked
    given = assign(plane, start, plane.ids[asked], problem.targets[asked])
    planned = make_planner(DEFAULT_PLANNER).plan(Problem(plane, start, given.targets))
    done = discretize(plane, planned.motion, units, Safety(), counts)
    return OrderedField(plane, units, counts, done.wire, problem.targets)
