"""A problem from whatever names one: a file, a layout, an instrument."""

import numpy as np

from fiber_core.fields import random_problem
from fiber_core.presets import preset as preset_plane
from fiber_core.problem import Problem, load_problem
from fiber_core.tables import read_layout

__all__ = ["DEFAULT_PRESET", "problem_from"]

DEFAULT_PRESET = "desi"


def problem_from(problem=None, layout=None, preset=None, robots=None, seed: int = 0) -> Problem:
    """Return the problem in a file, or a random field on a layout or on an instrument.

    Args:
        problem: path of a problem.npz; stands before all others.
        layout: path of a table of robots; the preset fills what it lacks.
        preset: name of an instrument; without one the layout's arms tell, or desi.
        robots: how many robots of the preset; by default its own number.
        seed: of the random field.

    Raises:
        FiberError: no such preset, or a file is not what it should be.
        OSError: a file cannot be read.
    """
    if problem:
        return load_problem(problem)
    if layout:
        plane = read_layout(layout, preset or None)
    else:
        plane = preset_plane(preset or DEFAULT_PRESET, robots or None)
    return random_problem(plane, np.random.default_rng(seed))
