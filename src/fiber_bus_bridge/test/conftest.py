# SPDX-License-Identifier: Apache-2.0
"""Make the helper modules in this folder importable, and keep the memory of bridges apart."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))


@pytest.fixture(autouse=True)
def state_home(tmp_path, monkeypatch):
    """Bridges remember the robots of devices in a folder of the test, not of the user."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def rest(tmp_path):
    """The other nodes of the graph beside a bridge of simulated robots."""
    from rest_of_graph import Rest, problem_file  # needs ROS, which most tests here do not

    from fiber_node import RosClient

    with RosClient("rest") as peer:
        yield Rest(peer, problem_file(tmp_path))


@pytest.fixture
def night(tmp_path, monkeypatch):
    """A bridge that can be ended and begun anew beside its robots."""
    from night_rig import make_night  # needs ROS too

    yield from make_night(tmp_path, monkeypatch)
