# SPDX-License-Identifier: Apache-2.0
"""A sector on the adapters of its host: which buses it opens, and in which time."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_bus_bridge.node import hardware
from fiber_core.presets import preset
from fiber_core.problem import Problem, save_problem
from fiber_node import RosClient
from fiber_sectors import SectorError
from fiber_sectors.node import SectorNode

ROBOTS = 20


class Adapters:
    """Takes the place of LinuxBuses; no robot answers."""

    opened: list[dict[int, str]] = []

    def __init__(self, devices):
        self.opened.append(devices)

    def close(self):
        """Nothing is open."""


@pytest.fixture
def problem(tmp_path):
    plane, rows = preset("desi", ROBOTS), np.arange(ROBOTS)
    plane = replace(plane, bus=rows // 5, address=rows % 5 + 8)
    path = str(tmp_path / "problem.npz")
    start = np.stack([np.zeros(ROBOTS), np.full(ROBOTS, 3.1)], axis=1)
    save_problem(path, Problem(plane, start, np.full((ROBOTS, 2), np.nan)))
    return path


def sector_of(peer, problem, **parameters):
    given = {"sectors__shares": "0,1; 2,3", "sectors__number": 1, "problem": problem}
    return peer.add_node(SectorNode, **(given | parameters))


def test_a_sector_opens_the_adapters_of_its_own_buses_in_real_time(problem, monkeypatch):
    monkeypatch.setattr(hardware, "LinuxBuses", Adapters)
    monkeypatch.setattr(Adapters, "opened", [])
    devices = ["/dev/i2c-5", "/dev/i2c-7"]
    with RosClient("rest") as peer:
        node = sector_of(peer, problem, devices=devices, sectors__clock_scale=1.0)
        assert Adapters.opened == [{2: "/dev/i2c-5", 3: "/dev/i2c-7"}]
        assert isinstance(node.sector._leased._buses, Adapters)  # neither simulated nor paced


@pytest.mark.parametrize("scale", [0.0, 0.5])
def test_adapters_in_a_time_that_is_not_theirs_are_refused(problem, scale):
    with RosClient("rest") as peer, pytest.raises(SectorError, match="set it to 1 in all sectors"):
        sector_of(peer, problem, devices=["/dev/i2c-5"], sectors__clock_scale=scale)
