# SPDX-License-Identifier: Apache-2.0
"""A small plane of simulated robots, its buses, and a session with it."""

from dataclasses import replace

import numpy as np

from fiber_bus_bridge import Session, SessionState, addresses_of, bus_timing
from fiber_bus_bridge.simulation import Positioners, SimulatedBuses
from fiber_core.clearance import Safety, hold_until_safe
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import preset
from fiber_core.ragged import Parts
from fiber_core.wire_units import WireMotion, WireUnits


class Rig:
    """A plane of nearly folded robots on simulated buses, ten to each, and a session with it."""

    def __init__(
        self,
        n=19,
        start=None,
        enabled=None,
        config=None,
        faults=None,
        on_bus=10,
        certify=hold_until_safe,
        robots=None,
        phi_deg=(0.0, 180.0),
        **positioners,
    ):
        rows = np.arange(n)
        plane = replace(preset("desi", n), bus=rows // on_bus, address=8 + rows % on_bus)
        limits = np.array(plane.limits)
        limits[:, 1] = np.deg2rad(phi_deg)
        plane = self.changed(replace(plane, limits=limits))
        self.plane = plane if enabled is None else plane.with_enabled(enabled)
        self.units = WireUnits.for_plane(self.plane)
        folded = np.stack([np.linspace(-1, 1, n), np.full(n, 2.6)], axis=1)
        start = self.units.to_counts(folded if start is None else start)
        # robots of an earlier rig outlive its session
        self.robots = robots or Positioners(
            addresses_of(self.plane), self.plane.ids, self.units.quantum_prad, start, **positioners
        )
        self.session = Session(
            self.plane,
            self.units,
            Safety(),
            SimulatedBuses(self.robots, bus_timing("1M"), faults),
            self.units.to_angles(start),
            config,
            certify,
        )
        self.t = 0.0

    def changed(self, plane):
        """The plane, with what a rig of its own changes."""
        return plane

    def orders(self, theta, phi, ticks=250):
        """One segment for each moving joint: speeds of theta and phi [quanta per tick], (n,)."""
        velocity = np.stack(np.broadcast_arrays(theta, phi, np.zeros(self.plane.n)), 1)[:, :2]
        velocity = velocity.astype(np.int64).ravel()
        moves = velocity != 0
        offsets = Parts.from_counts(moves).offsets
        return WireMotion(
            self.units, self.session.counts, offsets, np.full(moves.sum(), ticks), velocity[moves]
        )

    def call(self, name, *arguments):
        self.t = max(self.t, getattr(self.session, name)(self.t, *arguments))

    def ready(self, theta=400, phi=0, targets=None):
        self.call("configure")
        motion = self.orders(theta, phi)
        self.session.submit(motion, targets)
        return motion

    def run(self):
        """Advance ten times a second until the plan ends."""
        for _ in range(200):
            if self.session.state is not SessionState.MOVING:
                return self.session.result
            self.t += 0.1
            self.call("advance")
        raise AssertionError("the plan does not end")

    def where(self):
        return self.robots.positions(self.t)


def ended_once(result, n):
    assert len(result.outcome) == len(result.reason) == len(result.error_mm) == n
    reached = result.outcome == Outcome.REACHED
    assert np.array_equal(reached, result.reason == Reason.OK)
