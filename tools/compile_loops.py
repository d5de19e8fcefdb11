"""Run small planes through the installed cores, so that every loop is compiled and cached."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "bench"))

import numpy as np
from plan_field import carry_out

from fiber_core.fields import random_problem
from fiber_core.presets import preset
from fiber_planner import planners


def main() -> int:
    """Compile; returns the exit code."""
    for planner in planners():
        problem = random_problem(preset("desi_outlines", robots=37), np.random.default_rng(0))
        carry_out(problem, planner)
    return 0


if __name__ == "__main__":
    sys.exit(main())
