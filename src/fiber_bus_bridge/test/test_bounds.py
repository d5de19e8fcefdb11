# SPDX-License-Identifier: Apache-2.0
"""Absurd settings of a session and of a simulation are refused by name."""

from dataclasses import fields

import numpy as np
import pytest

from fiber_bus_bridge import SessionConfig
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.simulation import SimulationConfig

EXTREMES = (-1.0, np.nan, np.inf, 1e-300, 1e12, 1e25, 2.0**63, "many", None)
NUMBERS = [
    (config, field.name)
    for config in (SessionConfig, SimulationConfig)
    for field in fields(config)
    if not isinstance(field.default, str)
]
FITTING = {("stretch_s", np.inf), ("stretch_s", 1e12), ("stretch_s", 1e25), ("stretch_s", 2.0**63)}
FITTING |= {("seed", 1e12), ("seed", 2.0**63), ("spacing_mm", -1.0)}


@pytest.mark.parametrize("extreme", EXTREMES, ids=str)
@pytest.mark.parametrize("config, name", NUMBERS)
def test_an_extreme_setting_is_refused_by_name(config, name, extreme):
    tiny = extreme == 1e-300 and isinstance(getattr(config(), name), float)
    if (name, extreme) in FITTING or (tiny and name != "heartbeat_period_s"):
        config(**{name: extreme})
        return
    with pytest.raises(BridgeError, match=name):
        config(**{name: extreme})


def test_an_unknown_bus_clock_is_refused():
    with pytest.raises(BridgeError, match="bus mode '2M' does not exist"):
        SimulationConfig(clock="2M")


def test_an_absurd_number_of_faults_is_refused():
    with pytest.raises(BridgeError, match="number of faults 'stall'"):
        SimulationConfig(faults="stall:1000000000000")
