# SPDX-License-Identifier: Apache-2.0
"""The simulated plant: faults requested by name, and its separation from run-time code."""

import subprocess
import sys

import numpy as np
import pytest

from fiber_bus_bridge import BridgeError
from fiber_bus_bridge.simulation import Event, FaultKind, SimulationConfig, simulated_buses
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits

PLANE = preset("desi", 37)
UNITS = WireUnits.for_plane(PLANE)
START = np.tile([0.0, 3.0], (37, 1))


RUN_TIME = """
availability bus bus.linux capture disabled_list frame_log home plan_result poll_scheduler
protocol remaining_motion replanning session session_config transactions wire
"""


def test_run_time_code_does_not_import_the_simulation():
    # one process: after each import no module of the simulation may be loaded
    code = "\n".join(
        f"import fiber_bus_bridge.{module}, sys\n"
        f"assert not [m for m in sys.modules if 'simulation' in m], {module!r}"
        for module in RUN_TIME.split()
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=250)


def test_faults_are_named_and_counted():
    kinds = SimulationConfig(faults="stall:2, Reset").fault_kinds()
    assert kinds == [FaultKind.STALL, FaultKind.STALL, FaultKind.RESET]
    assert SimulationConfig().fault_kinds() == []


@pytest.mark.parametrize("faults", ["stal", "stall:x", "stall:-1", ":2"])
def test_an_unknown_fault_is_refused_with_a_list_of_the_known_faults(faults):
    with pytest.raises(BridgeError, match="stuck_joint"):
        SimulationConfig(faults=faults)


def test_faults_begin_in_the_requested_period_and_repeat_for_a_seed():
    config = SimulationConfig(faults="stall:20", faults_from_s=3.0, faults_until_s=3.5, seed=4)
    events = [simulated_buses(PLANE, UNITS, START, config)._faults.events for _ in range(2)]
    assert np.array_equal(*events) and len(events[0]) == 20
    assert set(events[0]["event"]) <= {Event.JAM_THETA, Event.JAM_PHI}
    assert 3.0 <= events[0]["t"].min() < events[0]["t"].max() < 3.5
    other = simulated_buses(
        PLANE, UNITS, START, SimulationConfig(faults="stall:20", faults_from_s=3.0, seed=5)
    )
    assert not np.array_equal(other._faults.events, events[0])
