# SPDX-License-Identifier: Apache-2.0
"""HOME of robots whose motors have only listed speeds."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_bus_bridge import Session, SessionState
from fiber_bus_bridge.listed_home import listed_home_motion
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses
from fiber_core.clearance import Safety, certify
from fiber_core.drive import Drive, rules_broken
from fiber_core.drive.listed_units import listed_units
from fiber_core.drive.named import with_drive
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits

N = 24
PLANE = with_drive(preset("desi_petals", N), "desi", motors_on=0.55)
UNITS = WireUnits.for_plane(PLANE)
ALL = np.ones(N, dtype=bool)


def with_list(**changes):
    """The plane with another list of speeds."""
    listed = replace(PLANE.drive.listed, **changes)
    return replace(PLANE, drive=Drive(N, listed=listed, scale=PLANE.drive.scale))


def starts(plane, seed):
    """Counts at random places inside the ranges."""
    low, high = np.moveaxis(UNITS.range_counts(plane), -1, 0)
    return np.random.default_rng(seed).integers(low, high + 1)


@pytest.mark.parametrize(
    "plane",
    [
        PLANE,
        with_list(approach_sign=np.array([-1.0, -1.0])),
        with_list(returns=False),
        with_list(approach_rad=np.zeros(2)),
        with_list(ramp_s=np.array([0.022, 0.01]), least_rad=np.deg2rad([4.53, 0.5])),
        with_list(approach_rad=np.deg2rad([3.0, 25.0])),  # longer than a segment
    ],
    ids=["desi", "falling", "no return", "no approach", "slow ramp", "long"],
)
@pytest.mark.parametrize("seed", range(3))
def test_home_is_of_moves_that_the_motors_can_make(plane, seed):
    start, limits = starts(plane, seed), UNITS.range_counts(plane)
    motion = listed_home_motion(plane, UNITS, start, limits[:, 1, 1], ALL)
    ordered = motion.decoded()
    assert len(rules_broken(plane.drive, ordered)) == 0
    assert (ordered.highest[:, 1] <= UNITS.to_angles(limits[:, :, 1])[:, 1] + 1e-9).all()
    assert (motion.end[:, 0] == start[:, 0]).all() and motion.moves.sum() > N // 2
    run = listed_units(plane, UNITS).velocity[:, 0, 1, 1]
    listed, left = plane.drive.listed, limits[:, 1, 1] - motion.end[:, 1]
    far = np.ceil(2 * listed.approach_rad[1] / UNITS.quantum_rad) + run  # with the way back
    assert (left[motion.moves] <= far[motion.moves]).all()
    if listed.approach_sign[1] > 0.0 and listed.approach_rad[1] > 0.0 and listed.returns:
        creep = listed_units(plane, UNITS).velocity[:, listed.approach_speed, 1, 1]
        assert (left[motion.moves] < creep[motion.moves]).all()


def test_robots_that_are_near_their_limit_or_not_chosen_rest():
    start, limits = starts(PLANE, 1), UNITS.range_counts(PLANE)
    start[3, 1] = limits[3, 1, 1] - 1000
    chosen = ALL.copy()
    chosen[5] = False
    motion = listed_home_motion(PLANE, UNITS, start, limits[:, 1, 1], chosen)
    assert not motion.moves[[3, 5]].any() and motion.moves.any()


def test_robots_with_listed_speeds_go_home_over_the_bus():
    angles = UNITS.to_angles(starts(PLANE, 0))
    angles[:, 1] = np.deg2rad(100.0)  # no pair of arms is near another
    buses = simulated_buses(PLANE, UNITS, angles, SimulationConfig(preset="desi_petals", robots=N))
    session = Session(PLANE, UNITS, Safety(), buses, angles)
    t = session.home(session.configure(0.0))
    while session.state is SessionState.MOVING:
        t = max(t + 0.1, session.advance(t + 0.1))
    sent = session.loaded_plan
    assert certify(PLANE, sent.motion.decoded(), Safety()).ok
    usable = PLANE.enabled
    assert sent.started[usable].all() and (session.result.reason[usable] == Reason.OK).all()
    creep = listed_units(PLANE, UNITS).velocity[:, 1, 1, 1]
    left = UNITS.range_counts(PLANE)[:, 1, 1] - session.counts[:, 1]
    assert ((left >= 0) & (left < creep))[usable].all()
