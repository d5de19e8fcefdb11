# SPDX-License-Identifier: Apache-2.0
"""Gears that couple joints: in CONFIG, checked by robots, and verified before every GO."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_bus_bridge import Session, SessionState, addresses_of
from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses
from fiber_bus_bridge.wire import Configuration, Fault, Gears, encode_config, encode_load
from fiber_core.clearance import Safety
from fiber_core.clearance.certificate import limits_broken
from fiber_core.motors import motors_broken
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits

PLANE = preset("spec_s5", 19)
INDEPENDENT = replace(PLANE, coupling=None, motor_speeds=None, motor_limits=None)
UNITS = WireUnits.for_plane(PLANE)
START = np.tile([0.0, 2.0], (PLANE.n, 1))
CONFIG = SimulationConfig(preset="spec_s5", robots=PLANE.n)


class Geared:
    """Simulated robots with gears, and a session with them."""

    def __init__(self, plane=PLANE):
        self.buses = simulated_buses(PLANE, UNITS, START, CONFIG)
        self.memory = self.buses.positioners.memory
        self.session = Session(plane, UNITS, Safety(), self.buses, START)
        self.t = 0.0

    def call(self, name, *arguments):
        self.t = max(self.t, getattr(self.session, name)(self.t, *arguments))

    def orders(self, *segments):
        """The same orders for all robots: (ticks, velocity) of theta and of phi."""
        theta, phi = ([*joint] for joint in segments)
        ticks, velocity = np.tile(np.array([*theta, *phi]), (PLANE.n, 1)).T
        offsets = np.concatenate([[0], np.cumsum(np.tile([len(theta), len(phi)], PLANE.n))])
        return WireMotion(UNITS, self.session.counts, offsets, ticks, velocity)


def test_robots_are_told_their_gears_and_carry_out_orders():
    rig = Geared()
    rig.call("configure")
    assert rig.session.known.all()
    rig.session.submit(rig.orders([(100, 600)], [(100, 600)]))
    rig.call("start")
    while rig.session.state is SessionState.MOVING:
        rig.t += 0.1
        rig.call("advance")
    assert (rig.session.result.reason == Reason.OK).all()


def test_a_robot_whose_gears_are_others_is_not_configured():
    rig = Geared()
    rig.memory["coupling"][3, 1] = [0, 2**22]  # independent joints
    rig.memory["coupling"][7, 1, 0] += 1
    rig.call("configure")
    assert np.flatnonzero(~rig.session.known).tolist() == [3, 7]
    assert set(rig.memory["fault"][[3, 7]]) == {Fault.OTHER_GEARS}


def test_robots_with_gears_refuse_the_configuration_of_independent_joints():
    rig = Geared(INDEPENDENT)
    rig.call("configure")
    assert not rig.session.known.any()
    assert set(rig.memory["fault"]) == {Fault.OTHER_GEARS}


def test_robots_with_independent_joints_refuse_gears():
    rig = Geared()
    rig.memory["coupling"] = 0
    rig.call("configure")
    assert not rig.session.known.any()


def test_robots_with_independent_joints_refuse_gears_that_couple_nothing():
    rig = Geared()
    rig.memory["coupling"] = 0
    none = np.zeros((PLANE.n, 2, 2), dtype=int)
    gears = Gears(none, none, np.zeros((PLANE.n, 2), dtype=int))
    config = Configuration(
        UNITS, UNITS.range_counts(PLANE), np.full((PLANE.n, 2), 9), 0, gears=gears
    )
    rig.buses.transfer(encode_config(config, addresses_of(PLANE)), 0, 0.0)
    assert set(rig.memory["fault"]) == {Fault.OTHER_GEARS}


def random_orders(rng):
    """Orders of up to three segments a joint, half of them near the speed of the motors."""
    counts = rng.integers(0, 4, 2 * PLANE.n)
    total = int(counts.sum())
    fastest = PLANE.speeds[0] / UNITS.velocity_rad_s
    joint = np.repeat(np.tile([0, 1], PLANE.n), counts)
    velocity = rng.uniform(-1, 1, total) * rng.choice([0.3, 1.0], total) * fastest[joint]
    offsets = Parts.from_counts(counts).offsets
    ticks = rng.integers(1, 150, total)
    return WireMotion(UNITS, UNITS.to_counts(START), offsets, ticks, np.trunc(velocity).astype(int))


def test_robots_accept_the_orders_that_the_certificate_passes_and_no_others():
    rng, seen = np.random.default_rng(0), np.zeros(3, dtype=int)
    rig = Geared()
    rig.call("configure")
    faster, wider = PLANE.motor_speeds * (1 + 1e-5), PLANE.motor_limits * 1.0001
    beyond = replace(PLANE, motor_speeds=faster, motor_limits=wider)
    for sequence in np.tile(np.arange(1, 16), 10):
        orders = random_orders(rng)
        motion = orders.decoded()
        inside = ~limits_broken(INDEPENDENT, motion)
        rig.memory["fault"] = 0
        rig.buses.transfer(encode_load(addresses_of(PLANE), sequence, orders), 0, rig.t)
        refused = rig.memory["fault"] != 0
        assert np.isin(rig.memory["fault"], (0, Fault.OVER_SPEED, Fault.OUTSIDE_LIMITS)).all()
        bad, worse = motors_broken(PLANE, motion), motors_broken(beyond, motion)
        assert not (refused & inside & ~bad).any()
        assert refused[worse].all()
        seen += [(inside & bad).sum(), (inside & ~bad).sum(), (~inside).sum()]
    assert (seen > 100).all()


def test_a_coupling_that_does_not_fit_its_field_is_refused():
    coupling = PLANE.coupling.copy()
    coupling[4, 1] = [-600.0, 600.0]
    plane = replace(PLANE, coupling=coupling, motor_speeds=None, motor_limits=None)
    with pytest.raises(WireError, match=f"robot {PLANE.ids[4]}: a coupling of 600"):
        Gears.of(plane, UNITS)
