# SPDX-License-Identifier: Apache-2.0
"""Arms of simulated motors with a ramp: the certified curve, and how they rest after a stop."""

import numpy as np
import pytest

from fiber_bus_bridge import Session
from fiber_bus_bridge.simulation import (
    Mechanics,
    ObservedBuses,
    SimulationConfig,
    TrueMotion,
    arms_at,
    arms_motion,
    simulated_buses,
)
from fiber_core.clearance import Safety, certify_arms, neighbour_pairs
from fiber_core.drive.curves import carried_out
from fiber_core.drive.named import with_drive
from fiber_core.presets import preset
from fiber_positioners import make_orders, random_problem, run_on_simulated_buses

TOUCH = Safety(margin_mm=0.0, start_skew_s=0.0, stop_skew_s=0.0)


def orders_of(name, drive, robots, seed):
    return make_orders(random_problem(with_drive(preset(name, robots), drive), seed=seed))


def ideal_arms(counters):
    mechanics = Mechanics.ideal(counters.segments.n)
    return arms_motion(mechanics, arms_at(mechanics, counters.segments.start), *counters)[0]


@pytest.mark.parametrize("seed", range(3))
def test_the_speed_of_an_arm_is_the_mean_of_its_counters_over_the_ramp(seed):
    orders = orders_of("desi", "accelerated", 61, seed)
    ramp_s = orders.plane.drive.ramp_s
    counters = run_on_simulated_buses(orders, seed=seed, observe=True).counters
    line, arms = counters.segments, ideal_arms(counters)
    furthest = 0.0
    for t in np.linspace(0.0, line.makespan_s + ramp_s, 400):
        mean = (line(t) - line(t - ramp_s)) / ramp_s
        assert np.allclose(arms.velocity(t), mean, atol=1e-6)
        furthest = max(furthest, np.abs(arms(t) - line(t)).max())
    assert furthest > 0.03  # the arms are behind: by half a ramp at full speed
    assert np.allclose(arms.end, line.end, atol=1e-9)
    assert arms.makespan_s == pytest.approx(line.makespan_s + ramp_s)


def test_arms_of_listed_speeds_make_the_curve_of_the_certificate():
    orders = orders_of("desi_petals", "desi", 120, 4)
    drive = orders.plane.drive
    run = run_on_simulated_buses(orders, seed=1, observe=True)
    counters = run.counters
    arms, expected = ideal_arms(counters), carried_out(drive, counters.segments)
    assert np.allclose(arms.end, expected.end, atol=1e-9)
    times = np.linspace(0.0, counters.segments.makespan_s + 0.1, 500)
    assert max(np.abs(arms(t) - expected(t)).max() for t in times) < 1e-9
    assert max(np.abs(arms(t) - counters.segments(t)).max() for t in times) > 0.01
    steepest = (np.abs(drive.listed.speeds_rad_s[0]) * drive.scale / drive.listed.ramp_s[0]).max()
    assert 0.5 * steepest < arms.hardest.max() < 1.01 * steepest


def test_motors_that_were_told_no_ramp_make_the_lines_of_their_counters():
    counters = run_on_simulated_buses(orders_of("desi", "ideal", 61, 0), observe=True).counters
    assert not counters.ramp_s.any()
    arms = ideal_arms(counters)
    assert np.array_equal(arms.velocity_rad_s, counters.segments.velocity_rad_s)


@pytest.mark.parametrize("seed", range(4))
def test_a_stop_lets_the_arms_come_to_rest_where_their_counters_stand(seed):
    orders = orders_of("desi", "accelerated", 127, seed)
    plane, units, drive = orders.plane, orders.units, orders.plane.drive
    start = units.to_angles(orders.counts)
    buses = simulated_buses(plane, units, start, SimulationConfig(seed=seed))
    truth = TrueMotion(buses.positioners, units.quantum_rad)
    session = Session(plane, units, orders.safety, ObservedBuses(buses, truth), start)
    ready_s = session.configure(0.0)
    session.submit(orders.wire, orders.targets)
    now_s = session.start(ready_s)
    begin_s = session.loaded_plan.start_s
    now_s = session.advance(begin_s + (0.2 + 0.15 * seed) * orders.wire.decoded().makespan_s)
    now_s = session.stop(now_s)
    end_s = now_s + 1.0
    counters = truth.movements(end_s).counters(orders.counts, units.quantum_rad, end_s, ready_s)
    arms = ideal_arms(counters)
    assert not counters.segments.velocity(now_s - ready_s).any()
    assert (arms.velocity(now_s - ready_s + drive.ramp_s) == 0.0).all()
    assert np.allclose(arms.end, counters.segments.end, atol=1e-9)
    fastest = plane.speeds / drive.ramp_s
    assert (arms.hardest <= 2.001 * fastest).all()  # a reversal at full speed
    assert certify_arms(plane, arms, TOUCH, neighbour_pairs(plane)).ok
