# SPDX-License-Identifier: Apache-2.0
"""A focal plane of a few dozen robots, some of them disabled, for the tests of the graph."""

import sys
from pathlib import Path

import numpy as np
import pytest

from fiber_core.fields import random_problem
from fiber_core.presets import preset
from fiber_core.problem import save_problem

sys.path.append(str(Path(__file__).parent))  # helper modules in this folder

ROBOTS = 61
DISABLED = [3, 17, 40]


@pytest.fixture(scope="session")
def problem():
    """Random starts, and targets for all that are enabled."""
    enabled = ~np.isin(np.arange(ROBOTS), DISABLED)
    plane = preset("desi", ROBOTS).with_enabled(enabled)
    return random_problem(plane, np.random.default_rng(7))


@pytest.fixture(scope="session")
def problem_file(problem, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("problem") / "problem.npz"
    save_problem(path, problem)
    return str(path)
