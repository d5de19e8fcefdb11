"""Sources of problems: a problem file, a layout table or a preset."""

import numpy as np

from fiber_core.fields import random_problem
from fiber_core.presets import preset as preset_plane
from fiber_core.problem import FilePath, Problem, load_problem
from fiber_core.tables import read_layout

__all__ = ["DEFAULT_PRESET", "problem_from"]

DEFAULT_PRESET = "desi"


def problem_from(
    problem: FilePath | None = None,
    layout: FilePath | None = None,
    preset: str | None = None,
    robots: int | None = None,
    seed: int = 0,
) -> Problem:
    """Return the problem in a file, or a random field on a layout or on a preset.

    Args:
        problem: path of a problem.npz; if it is given, all other arguments are ignored.
        layout: path of a table of robots; the preset supplies the columns that it lacks.
        preset: name of an instrument; by default the instrument with the arm lengths of the
            layout, and without a layout `DEFAULT_PRESET`.
        robots: number of robots of the preset; by default that of the instrument.
        seed: seed of the random field.

    Raises:
        FiberError: no preset has this name, or a file does not hold a problem or a layout.
        OSError: a file cannot be read.
    """
    if problem:
        return load_problem(problem)
    if layout:
        plane = read_layout(layout, preset or None)
    else:
        plane = preset_plane(preset or DEFAULT_PRESET, robots or None)
    return random_problem(plane, np.random.default_rng(seed))
