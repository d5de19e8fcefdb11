# SPDX-License-Identifier: Apache-2.0
"""A reconfiguration of a small plane that the tests of this package share."""

import pytest

from fiber_positioners import Reconfiguration, preset, random_problem, reconfigure


@pytest.fixture(scope="session")
def result() -> Reconfiguration:
    """37 robots of DESI's size, all with targets."""
    return reconfigure(random_problem(preset("desi", 37), seed=1), planner="direct", seed=2)
