# SPDX-License-Identifier: Apache-2.0
"""The report of a plan tells which robots their motors held, with the reason and the value."""

import json
from dataclasses import replace

import numpy as np

from fiber_core import SegmentMotion, kinematics, preset
from fiber_core.drive import Drive, carried_out
from fiber_core.drive.named import with_drive
from fiber_core.drive.told import accelerations_told
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_positioners import make_orders, random_problem, reconfigure
from fiber_positioners.held_by_drive import held_by_drive


def test_a_speed_that_is_not_listed_is_told_with_its_value():
    plane = with_drive(preset("desi", 7), "desi")
    orders = make_orders(random_problem(plane, seed=1), planner="direct")
    held = held_by_drive(orders)
    assert [robot["id"] for robot in held] == plane.ids[orders.reason != Reason.OK].tolist()
    assert {robot["reason"] for robot in held} == {"bad_trajectory"} and held
    assert all("deg/s" in robot["told"] for robot in held)


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
        "told": f"the approach of phi to 1 deg begins at -2 deg, its range is {low:.4g} to "
        f"{high:.4g} deg",
    }
    assert json.loads(json.dumps(result.report))["held_by_drive"] == [robot]


def test_a_robot_that_is_too_many_for_its_supply_is_told_with_the_cap():
    plane = replace(preset("desi", 7), drive=Drive(7, supply=np.full(7, 4), motors_on=0.5))
    orders = make_orders(random_problem(plane, seed=1), planner="direct")
    held = [robot for robot in held_by_drive(orders) if robot["reason"] == "overload"]
    assert len(held) == (orders.reason == Reason.OVERLOAD).sum() > 0
    assert held[0]["told"] == (
        "its motors are too many for supply 4, which feeds 7 of its 14 motors at once"
    )


def test_a_segment_too_short_for_the_ramp_is_told_with_the_acceleration():
    drive = Drive(2, ramp_s=0.1, acceleration_rad_s2=np.deg2rad(2000.0))
    speed = np.deg2rad(150.0)
    motion = SegmentMotion(
        np.zeros((2, 2)), [0, 0, 1, 3, 3], [0.5, 0.3, 0.3], [speed, speed, -speed]
    )
    told = accelerations_told(drive, carried_out(drive, motion), np.array([8, 5]))
    assert told == [
        "robot 5: theta is to change its speed by 300 deg/s within its ramp of 0.1 s, at 3000 "
        "deg/s2; its motor does 2000 deg/s2 at most"
    ]


def test_nothing_is_told_where_all_robots_move():
    plane = with_drive(preset("desi", 7), "desi")
    assert reconfigure(random_problem(plane, seed=1)).report["held_by_drive"] == []
