# SPDX-License-Identifier: Apache-2.0
"""Shared by the tests of this package."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))  # for the modules that tests share


@pytest.fixture
def scene():
    """Return robots after a move, and a camera before which nothing goes wrong."""
    from metrology_scene import Scene

    return Scene()
