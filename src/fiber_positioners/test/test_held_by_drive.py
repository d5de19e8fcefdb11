# SPDX-License-Identifier: Apache-2.0
"""The report of a plan tells which robots their motors held, with the reason and the value."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fiber_core import SampledMotion, SegmentMotion, kinematics, preset
from fiber_core.clearance import Safety
from fiber_core.drive import Drive, MotorRule, carried_out
from fiber_core.drive.checks import accelerations
from fiber_core.drive.named import with_drive
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_discretizer import discretize
from fiber_positioners import make_orders, random_problem, reconfigure
from fiber_positioners.held_by_drive import held_by_drive


def test_a_speed_that_is_not_listed_is_told_with_its_value():
    plane = with_drive(preset("desi", 7), "desi")
    orders = make_orders(random_problem(plane, seed=1), planner="direct")
    held = held_by_drive(orders)
    assert [robot["id"] for robot in held] == plane.ids[orders.reason != Reason.OK].tolist()
    assert {robot["reason"] for robot in held} == {"bad_trajectory"} and held
    assert all("deg/s" in robot["told"] for robot in held)
    rules = [rule for robot in held for rule in robot["rules"]]
    assert {rule["rule"] for rule in rules} == {"whole_units"}
    assert all(rule["joint"] in ("theta", "phi") and rule["value"] > 0.0 for rule in rules)


def test_an_approach_that_leaves_the_range_is_told_with_its_angles():
    plane = with_drive(preset("desi", 3), "desi")
    end = plane.limits.mean(axis=2)
    start = end.copy()
    end[1] = (0.4, np.deg2rad(1.0))
    targets = np.full((3, 2), np.nan)
    targets[1] = kinematics.forward(plane, end)[1][1]
    result = reconfigure(Problem(plane, start, targets))
    (robot,) = result.report["held_by_drive"]
    low, high = np.rad2deg(plane.limits[1, 1])
    assert robot == {
        "id": int(plane.ids[1]),
        "reason": "outside_joint_range",
        "rules": [
            {
                "rule": "approach_begin",
                "joint": "phi",
                "value": pytest.approx(np.deg2rad(-2.0)),
                "least": plane.limits[1, 1, 0],
                "most": plane.limits[1, 1, 1],
            }
        ],
        "told": f"the approach of phi to 1 deg begins at -2 deg, its range is {low:.4g} to "
        f"{high:.4g} deg",
    }
    assert json.loads(json.dumps(result.report))["held_by_drive"] == [robot]


def test_a_robot_that_is_too_many_for_its_supply_is_told_with_the_cap():
    plane = replace(preset("desi", 7), drive=Drive(7, supply=np.full(7, 4), motors_on=0.5))
    orders = make_orders(random_problem(plane, seed=1), planner="direct")
    held = [robot for robot in held_by_drive(orders) if robot["reason"] == "overload"]
    assert len(held) == (orders.reason == Reason.OVERLOAD).sum() > 0
    assert held[0]["rules"] == [
        {"rule": "supply", "joint": None, "value": 8.0, "least": None, "most": 7.0}
    ]
    assert held[0]["told"] == (
        "its motors are too many for supply 4, which feeds 7 of its 14 motors at once"
    )


def test_a_segment_too_short_for_the_ramp_is_told_with_the_acceleration():
    drive = Drive(2, ramp_s=0.1, acceleration_rad_s2=np.deg2rad(2000.0))
    speed = np.deg2rad(150.0)
    motion = SegmentMotion(
        np.zeros((2, 2)), [0, 0, 1, 3, 3], [0.5, 0.3, 0.3], [speed, speed, -speed]
    )
    found = accelerations(drive, carried_out(drive, motion))
    assert found.told(drive, [0, 0], np.array([8, 5])) == [
        "robot 5: theta is to change its speed by 300 deg/s within its ramp of 0.1 s, at 3000 "
        "deg/s2; its motor does 2000 deg/s2 at most"
    ]


def test_a_motor_that_is_weaker_than_the_others_turns_as_fast_as_it_can():
    plane = with_drive(preset("desi", 7), "accelerated")
    limit = plane.drive.acceleration_rad_s2.copy()
    limit[3, 1] *= 0.25
    weak = replace(plane, drive=Drive(7, plane.drive.ramp_s, limit))
    result = reconfigure(random_problem(weak, seed=2))
    assert result.report["reached"] == 7 and result.report["drive_violations"] == 0
    assert result.motion.moves[3] and result.report["held_by_drive"] == []


def test_a_trajectory_that_is_too_hard_for_a_motor_is_told_with_the_acceleration():
    plane = with_drive(preset("desi", 2), "accelerated")
    limit = plane.drive.acceleration_rad_s2.copy()
    limit[1] *= 0.05
    weak = replace(plane, drive=Drive(2, plane.drive.ramp_s, limit))
    start = plane.limits.mean(axis=2)
    ends = np.stack([start, start + 0.4 * plane.speeds], axis=2)
    done = discretize(weak, SampledMotion([0.0, 1.0], ends), WireUnits.for_plane(weak), Safety())
    assert done.reason[1] == Reason.UNSAFE
    entries = done.breaches.robot == 1
    hardest = 0.4 * plane.speeds[1] / plane.drive.ramp_s
    np.testing.assert_allclose(done.breaches.value[entries], hardest, rtol=1e-6)
    assert (done.breaches.rule[entries] == MotorRule.ACCELERATION).all()
    assert not (~entries).any()


def test_an_order_longer_than_any_is_told_with_its_end():
    """One motor at a time: the last ones would still move after the end of the longest order."""
    plane = with_drive(preset("desi", 12), "desi", motors_on=0.05)
    orders = make_orders(random_problem(plane, seed=2))
    late = [robot for robot in held_by_drive(orders) if robot["reason"] == "bad_trajectory"]
    assert len(late) == (orders.reason == Reason.BAD_TRAJECTORY).sum() > 0
    rules = [rule for robot in late for rule in robot["rules"]]
    assert all(rule["rule"] == "order_length" and rule["value"] > rule["most"] for rule in rules)


def test_a_joint_that_its_gear_makes_too_fast_is_told_with_its_speed():
    plane = with_drive(preset("desi", 3), "desi")
    scale = plane.drive.scale.copy()
    scale[1, 1] = 3.0
    fast = replace(plane, drive=Drive(3, listed=plane.drive.listed, scale=scale))
    orders = make_orders(random_problem(fast, seed=2))
    (robot,) = held_by_drive(orders)
    assert robot["id"] == plane.ids[1] and robot["reason"] == "bad_trajectory"
    (rule,) = robot["rules"]
    assert rule["rule"] == "joint_speed" and rule["joint"] == "phi"
    assert rule["value"] > rule["most"] == plane.speeds[1, 1]


def test_nothing_is_told_where_all_robots_move():
    plane = with_drive(preset("desi", 7), "desi")
    assert reconfigure(random_problem(plane, seed=1)).report["held_by_drive"] == []
