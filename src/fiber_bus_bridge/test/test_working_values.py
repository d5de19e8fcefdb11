# SPDX-License-Identifier: Apache-2.0
"""Values that robots work by: verified before every GO, and checked once more at the GO."""

import numpy as np
import pytest

from fiber_bus_bridge import Session, SessionState
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses
from fiber_bus_bridge.simulation.firmware import receive
from fiber_bus_bridge.simulation.positioners import Positioners
from fiber_bus_bridge.simulation.working_values import place_crc, working_crc
from fiber_bus_bridge.wire import (
    Addresses,
    Configuration,
    Fault,
    Gears,
    Ramps,
    RobotState,
    Speeds,
    config_crcs,
    encode_config,
    gear_counts,
    place_crcs,
)
from fiber_core.clearance import Safety
from fiber_core.drive.listed_units import listed_units
from fiber_core.drive.named import with_drive
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits

GEARED, LISTED = preset("spec_s5", 7), with_drive(preset("desi_petals", 7), "desi")
RAMPED = with_drive(preset("desi_petals", 7), "accelerated")
CHANGED, OTHER = 3, 5  # rows of robots
SCALARS = ("tick_us", "velocity_bits", "duration_bits", "slot", "watchdog_s", "silence_s")
TABLES = [("limits", k) for k in range(4)] + [("speed", 0), ("speed", 1)]
GEARS = [(name, k) for name in ("coupling", "motor_limits") for k in range(4)]
GEARS += [("motor_speed", 0), ("motor_speed", 1)]
OF_ALL = [(name, 0) for name in (*SCALARS, "quantum_prad")] + TABLES
OF_LISTS = [("listed", k) for k in (0, 1, 3, 11, 19, 29, 45)] + [("listed_bytes", 0)]
OF_RAMPS = [("ramps", k) for k in range(4)] + [("ramp_bytes", 0)]
CASES = [(GEARED, *value) for value in OF_ALL + GEARS] + [(RAMPED, *each) for each in OF_RAMPS]
CASES += [(LISTED, *each) for each in [*OF_LISTS, *OF_RAMPS, ("ramps", 7)]]


class Rig:
    """Simulated robots, a session with them, and an order for each of them."""

    def __init__(self, plane):
        units = WireUnits.for_plane(plane)
        name = "spec_s5" if plane is GEARED else "desi_petals"
        start = np.tile([0.0, 2.0], (plane.n, 1)) if plane is GEARED else plane.limits.mean(axis=2)
        config = SimulationConfig(preset=name, robots=plane.n)
        self.buses = simulated_buses(plane, units, start, config)
        self.memory = self.buses.positioners.memory
        self.session = Session(plane, units, Safety(), self.buses, start)
        self.t = self.session.configure(0.0)
        assert self.session.known.all()
        self.begin = self.memory["position"].copy()
        self.session.submit(self.orders(plane, units))

    def orders(self, plane, units):
        """A short motion of each robot that its motors can make."""
        segments = [(100, 600), (50, -600)]
        if plane is LISTED:
            table, sign = listed_units(plane, units), plane.drive.listed.approach_sign[0]
            creep, rising = table.velocity[0, 1, 0], int(sign > 0)
            segments = [
                (table.back[0, 0], -sign * creep[1 - rising]),
                (table.forth[0, 0] + 50, sign * creep[rising]),
            ]
        ticks, velocity = np.tile(np.array(segments, dtype=int), (plane.n, 1)).T
        offsets = np.concatenate([[0], np.cumsum(np.tile([2, 0], plane.n))])
        return WireMotion(units, self.session.counts, offsets, ticks, velocity)

    def change(self, name, place):
        """Change a value of one robot by the least amount."""
        value = self.memory[name][CHANGED : CHANGED + 1].reshape(-1)
        if value.dtype.kind == "f":
            value[place] = np.nextafter(value[place], np.inf)
        else:
            value[place] ^= 1
        self.memory[name][CHANGED] = value.reshape(self.memory[name][CHANGED].shape)

    def carry_out(self):
        """Advance until the plan has ended."""
        while self.session.state is SessionState.MOVING:
            self.t = max(self.t + 0.1, self.session.advance(self.t + 0.1))


@pytest.mark.parametrize(("plane", "name", "place"), [*CASES, (GEARED, "position", 0)])
def test_a_robot_that_works_by_another_value_is_not_started(plane, name, place):
    rig = Rig(plane)
    rig.change(name, place)
    rig.session.start(rig.t)
    loaded = rig.session.loaded_plan
    assert np.flatnonzero(~loaded.started).tolist() == [CHANGED]
    assert loaded.reason[CHANGED] in (Reason.NOT_VERIFIED, Reason.REFUSED)
    assert np.isneginf(rig.memory["started_s"]).nonzero()[0].tolist() == [CHANGED]


@pytest.mark.parametrize(("plane", "name", "place"), CASES)
def test_a_value_that_changes_after_verify_moves_no_robot(plane, name, place):
    rig = Rig(plane)

    def may_go():
        rig.change(name, place)
        return True

    rig.t = rig.session.start(rig.t, may_go)
    robot = rig.memory[CHANGED]
    assert (robot["state"], robot["fault"]) == (RobotState.FAULT, Fault.MEMORY)
    assert np.isneginf(robot["started_s"])
    rig.carry_out()
    assert robot["position"].tolist() == rig.begin[CHANGED].tolist()
    loaded = rig.session.loaded_plan  # of the other robots, after the first start was cancelled
    assert np.flatnonzero(~loaded.started).tolist() == [CHANGED]
    assert loaded.reason[CHANGED] == Reason.NOT_ACKNOWLEDGED


@pytest.mark.parametrize("plane", [GEARED, LISTED, RAMPED], ids=["gears", "list", "ramp"])
def test_robots_whose_values_are_right_carry_out_their_orders(plane):
    rig = Rig(plane)
    rig.t = rig.session.start(rig.t)
    assert rig.session.loaded_plan.started.all()
    rig.carry_out()
    assert (rig.session.result.reason == Reason.OK).all()


@pytest.mark.parametrize("plane", [GEARED, LISTED, RAMPED], ids=["gears", "list", "ramp"])
def test_working_values_have_the_checksum_of_the_configuration(plane):
    units, rng = WireUnits.for_plane(plane), np.random.default_rng(1)
    to = Addresses(np.zeros(plane.n, int), np.arange(8, 8 + plane.n), np.zeros(plane.n, bool))
    position = rng.integers(-(2**31), 2**31, (plane.n, 2)) // 2
    robots = Positioners(
        to, np.arange(plane.n), units.quantum_prad, position, coupling=gear_counts(plane)
    )
    speed = rng.integers(0, 2**16, (plane.n, 2))
    for watchdog_ms, silence_ms in rng.integers(0, 2**16, (200, 2)).tolist():
        limits = rng.integers(-(2**31), 2**31, (plane.n, 2, 2))
        slot = rng.integers(0, 2**16, plane.n)
        config = Configuration(
            units, limits, speed, watchdog_ms, silence_ms, slot, Gears.of(plane, units),
            Speeds.of(plane, units), Ramps.of(plane),
        )  # fmt: skip
        frames = encode_config(config, to)
        for row in range(plane.n):
            assert accepted(robots, to, frames, row)
        crcs = [working_crc(robot) for robot in robots.memory]
        assert crcs == config_crcs(frames).tolist()
    assert [place_crc(robot) for robot in robots.memory] == place_crcs(position).tolist()


def accepted(robots, to, frames, row):
    """Whether a robot takes its frame."""
    data = np.frombuffer(frames.payload(row), dtype=np.uint8)
    return receive(
        robots.memory[row], int(to.address[row]), bool(to.ten_bit[row]), data, 0, len(data), 0.0
    )
