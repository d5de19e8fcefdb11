# SPDX-License-Identifier: Apache-2.0
"""Fields of robots whose motors have a list of speeds, from the problem to the bytes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fiber_core import preset
from fiber_core.clearance import Safety, certify, neighbour_pairs
from fiber_core.drive import carried_out, most_motors_on, rules_broken
from fiber_core.drive.named import with_drive
from fiber_core.fields import random_field, random_problem
from fiber_core.kinematics import on_target
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_discretizer import discretize
from fiber_planner import StraightPlanner
from fiber_positioners import reconfigure
from fiber_positioners.command.main import main
from fiber_positioners.orders import make_orders

_N = 40


@pytest.fixture(scope="module")
def problem():
    plane = with_drive(preset("desi_petals", _N), "desi", motors_on=0.55)
    return random_problem(plane, np.random.default_rng(3))


@pytest.fixture(scope="module")
def result(problem):
    return reconfigure(problem)


def test_a_field_is_planned_within_the_rules_and_certified(problem, result):
    plane, motion = problem.plane, result.motion
    report = result.report
    assert report["planner"] == "scheduled" and report["drive"] == "desi"
    assert report["reached"] >= 0.9 * report["asked"] > 0
    assert report["drive_violations"] == 0 and report["certified"]
    assert len(rules_broken(plane.drive, motion)) == 0
    assert certify(plane, motion, Safety()).ok
    true_motion = carried_out(plane.drive, motion)
    peak = most_motors_on(true_motion, plane.supply).max()
    assert report["motors_on_peak"] == peak and 0.0 < peak <= report["motors_on"] == 0.55
    assert report["makespan_s"] == true_motion.makespan_s
    assert report["lower_bound_s"] <= report["power_bound_s"] <= report["makespan_s"]


def test_the_same_seed_gives_the_same_orders(problem, result):
    again = make_orders(problem)
    assert (again.wire.ticks == result.orders.wire.ticks).all()
    assert (again.wire.velocity == result.orders.wire.velocity).all()


def test_the_plan_holds_the_true_curves(result, tmp_path):
    folder = result.save(tmp_path / "field", recording=False)
    true_motion = carried_out(result.plane.drive, result.motion)
    with np.load(folder / "plan.npz") as plan:
        last = plan["curve_offsets"][1:] - 1
        np.testing.assert_allclose(plan["curve_angle_rad"][last], true_motion.end.ravel())
        assert (plan["curve_velocity_rad_s"][last] == 0.0).all()
    with np.load(folder / "problem.npz") as saved:
        assert saved["motors_on"] == 0.55 and len(saved["listed_speeds"]) == 14


def test_profiles_that_listed_speeds_cannot_follow_are_held(problem, result):
    plane, units = problem.plane, result.orders.units
    start = units.to_angles(result.orders.counts)
    planned = result.orders.planned
    ends = np.stack([start, planned.goal], axis=2)
    straight = SampledMotion(np.array([0.0, 1000 * units.tick_s]), ends)  # all arrive together
    done = discretize(plane, straight, units, Safety())
    moves = np.ptp(ends, axis=2).any(axis=1)
    assert moves.any() and (done.reason[moves] == Reason.BAD_TRAJECTORY).all()
    assert not done.wire.moves.any()
    # each joint that would move, with its speed
    robot, joint = np.argwhere(np.ptp(ends, axis=2) > 0.0)[0]
    speed = np.rad2deg(np.ptp(ends, axis=2)[robot, joint]) / straight.time_s[-1]
    name = f"robot {plane.ids[robot]}: {('theta', 'phi')[joint]} is to turn"
    told = done.breaches.told(plane.drive, plane.supply, plane.ids)
    assert any(t.startswith(name) and f"{speed:.4g} deg/s" in t for t in told)


def test_the_command_takes_drive_and_share(capsys):
    arguments = ["plan", "--preset", "desi_petals", "--robots", "12", "--cold"]
    assert main([*arguments, "--drive", "desi", "--motors-on", "0.6"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["drive"] == "desi" and report["motors_on"] == 0.6
    assert 0.0 < report["motors_on_peak"] <= 0.6
    assert main([*arguments, "--drive", "desi", "--motors-on", "1.2"]) == 2
    assert "'1.2' is not above 0 and at most 1" in capsys.readouterr().err


def test_no_robot_is_held_for_what_the_planner_can_see():
    """Robots that have no way make way for the others, and the discretizer holds none."""
    plane = with_drive(preset("desi_petals", 60), "desi", motors_on=0.55)
    crowded = make_orders(random_problem(plane, np.random.default_rng(0)), planner="scheduled")
    assert not np.isin(crowded.reason, (Reason.UNSAFE, Reason.BAD_TRAJECTORY)).any()
    assert (crowded.reason == Reason.OK).sum() >= 55  # 52 of 60 without making way


def test_corrections_obey_the_rules_too():
    plane = with_drive(preset("desi_petals", _N), "desi", motors_on=0.55)
    rng = np.random.default_rng(5)
    arranged = random_field(plane, rng, gap_mm=1.0).problem
    places = on_target(plane, arranged.start, np.full((_N, 2), np.nan)).place
    way = rng.uniform(0.0, 2.0 * np.pi, _N)
    away = rng.uniform(0.05, 0.5, _N)[:, None] * np.stack([np.cos(way), np.sin(way)], axis=1)
    problem = replace(arranged, targets=places + away)
    orders = make_orders(problem, planner=StraightPlanner())
    asked = orders.start_problem.asked
    reached = asked & (orders.reason == Reason.OK)
    assert asked.sum() > 0.7 * _N and reached.sum() >= 0.9 * asked.sum()
    motion = orders.wire.decoded()
    assert certify(plane, motion, Safety()).ok and len(rules_broken(plane.drive, motion)) == 0
    ends = on_target(plane, motion.end, problem.targets)
    assert ends.error_mm[reached].max() < 0.005
    assert carried_out(plane.drive, motion).makespan_s < 5.0
    # no correction flips an elbow
    assert np.abs(motion.end - motion.start).max() < 0.5


def test_robots_that_are_one_too_many_for_their_supply_are_told_apart():
    plane = with_drive(preset("desi", 37), "ideal", motors_on=0.5)
    orders = make_orders(random_problem(plane, np.random.default_rng(1)))
    # half of them, and few that would touch one of these
    overload, unsafe = orders.reason == Reason.OVERLOAD, orders.reason == Reason.UNSAFE
    assert overload.sum() >= 18 and unsafe.sum() <= 3
    pairs = neighbour_pairs(plane)
    beside = np.zeros(plane.n, dtype=bool)
    beside[pairs[overload[pairs].any(axis=1)]] = True
    assert beside[unsafe].all()
