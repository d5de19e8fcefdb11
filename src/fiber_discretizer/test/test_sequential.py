# SPDX-License-Identifier: Apache-2.0
"""Sequential discretization: a safe motion stays safe, and hard cases."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.clearance import (
    Safety,
    certify,
    neighbour_pairs,
    point_speeds,
    sampled_gaps,
    unproven,
)
from fiber_core.fields import random_problem
from fiber_core.motion import SampledMotion, SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.threads import thread_count, threads
from fiber_core.wire_units import WireUnits
from fiber_discretizer import DiscretizeOptions, discretize
from fiber_discretizer.corridor import open_corridors
from fiber_discretizer.sequential import candidates
from fiber_discretizer.sequential.segment_plan import SegmentPlan
from fiber_discretizer.sequential.selection import Selection

UNITS = WireUnits()
SAFETY = Safety()
TRIANGLE = 10.4 * np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)]])


def pushed_apart(plane, start, goal, seconds=3.0, step_s=0.01, least_mm=2.0, reach_mm=5.0):
    """Joint angles pulled to their goals while tips push each other: curved, uneven paths.

    In the spirit of the navigation function of the papers: goals in joint space, a barrier
    between tips, both joints slowed down together at the speed limit.
    """
    angles, path = np.array(start, dtype=float), []
    for _ in range(int(seconds / step_s) + 1):
        path.append(angles.copy())
        elbow, tip = kinematics.forward(plane, angles)
        apart = tip[:, None] - tip[None]
        far = np.linalg.norm(apart, axis=2) + 1e3 * np.eye(plane.n)
        push = np.clip((reach_mm - far) / np.maximum(far - least_mm, 0.05), 0.0, 20.0)
        force = (0.5 * push / far)[:, :, None] * apart
        force = force.sum(axis=1)
        arm = np.stack([tip - plane.centers, tip - elbow], axis=1)
        torque = arm[..., 0] * force[:, None, 1] - arm[..., 1] * force[:, None, 0]
        rate = 4.0 * (goal - angles) + 0.3 * torque
        rate /= np.maximum(1.0, (np.abs(rate) / plane.speeds).max(axis=1))[:, None]
        angles = np.clip(angles + step_s * rate, plane.limits[..., 0], plane.limits[..., 1])
    time_s = step_s * np.arange(len(path))
    return SampledMotion(time_s, np.stack(path, axis=-1))


def three_robots(plane_at, seed):
    """Three neighbours that all pass between each other; valid starts and goals."""
    rng = np.random.default_rng(seed)
    plane = plane_at(TRIANGLE)
    pairs = neighbour_pairs(plane)
    inward = np.arctan2(*(TRIANGLE.mean(axis=0) - TRIANGLE).T[::-1])
    while True:
        turn = rng.uniform(0.5, 1.3, (2, 3)) * [[-1.0], [1.0]]
        ends = np.stack([inward + turn, rng.uniform(0.0, 0.9, (2, 3))], axis=-1)
        if sampled_gaps(plane, pairs, np.moveaxis(ends, 0, -1)).min() > 0.3:
            return plane, ends[0], ends[1]


@pytest.mark.parametrize("seed", range(12))
def test_three_robots_that_pass_between_each_other_take_three_segments_at_most(plane_at, seed):
    plane, start, goal = three_robots(plane_at, seed)
    trajectory = pushed_apart(plane, start, goal)
    result = discretize(plane, trajectory, UNITS, SAFETY)
    motion = result.wire.decoded()
    assert certify(plane, motion, SAFETY).ok
    assert motion.counts.max() <= 3
    going = result.reason == Reason.OK
    np.testing.assert_allclose(motion.end[going], trajectory.end[going], rtol=0, atol=2e-4)
    meet = sampled_gaps(plane, neighbour_pairs(plane), trajectory.angles).min() < 0.1
    if not meet:
        assert going.all()


def test_straight_lines_are_not_safe_in_the_case_of_three(plane_at):
    bent = 0
    for seed in range(12):
        plane, start, goal = three_robots(plane_at, seed)
        lines = SegmentMotion(start, np.arange(7), np.full(6, 2.0), (goal - start).ravel() / 2.0)
        bent += not certify(plane, lines, SAFETY).ok
    assert bent >= 3


def plan_of(plane, start):
    return SegmentPlan(plane, UNITS, UNITS.to_counts(start), SAFETY, 3.0)


def turning(start, goal, seconds=2.0):
    """One straight line for each joint."""
    lasts_s = np.full(2 * len(start), seconds)
    return SegmentMotion(
        start, np.arange(len(lasts_s) + 1), lasts_s, (goal - start).ravel() / seconds
    )


def test_a_segment_plan_has_the_unsafe_pairs_that_the_certificate_finds(plane_at):
    rng = np.random.default_rng(5)
    for seed in range(8):
        plane, start, goal = three_robots(plane_at, seed)
        plan = plan_of(plane, start)
        motion = turning(start, goal)
        order = rng.permutation(3)
        for row in order:  # assigned one by one, in any order
            plan.assign(np.array([row]), motion.of_robots([row]))
        required = SAFETY.required_at(
            point_speeds(plan.levers_mm, plan.motion.fastest), 3.0, plan.pairs
        )
        every = unproven(plan.bodies, plan.motion, plan.pairs, required)
        np.testing.assert_array_equal(plan.unsafe, every)
        again = plan.unproven(np.arange(len(plan.pairs)), np.arange(3), motion)
        np.testing.assert_array_equal(again, every)
        plan.rest(np.ones(3, dtype=bool))
        assert not plan.unsafe.any() and not plan.motion.moves.any()


def test_the_shortest_safe_motion_is_selected_and_never_an_unsafe_one(plane_at):
    plane = plane_at([[0.0, 0.0], [10.0, 0.0]])
    start = np.array([[-1.2, 0.0], [np.pi, 0.0]])
    plan = plan_of(plane, start)
    rows, idle = np.array([0]), np.array([True])
    through, short = (turning(start[:1], start[:1] + [turn, 0.0]) for turn in (2.4, -0.5))
    twice = SegmentMotion(start[:1], [0, 2, 3], [0.8, 0.4, 0.02], [-0.2, -0.15, 0.0])
    selection = Selection(plan, rows, idle, 0.0, 15)
    selection.evaluate(np.array([0]), through)
    assert len(selection.unsolved()) == 1  # robot 1 stands in the way
    selection.evaluate(np.array([0]), twice)
    assert len(selection.unsolved()) == 0
    selection.evaluate(np.array([0]), short, np.array([False]))
    selection.evaluate(np.array([0]), short)
    np.testing.assert_array_equal(selection.commit(), [0])
    np.testing.assert_array_equal(plan.motion.velocity_rad_s, short.velocity_rad_s)
    assert not plan.unsafe.any()
    second = Selection(plan, rows, np.array([False]), 0.0, 15)
    second.evaluate(np.array([0]), twice)
    assert len(second.commit()) == 0  # no longer motion replaces a safe one


def test_a_motion_with_too_many_segments_is_not_selected(plane_at):
    plane = plane_at([[0.0, 0.0]])
    plan = plan_of(plane, np.array([[0.0, 0.0]]))
    selection = Selection(plan, np.array([0]), np.array([True]), 0.0, 2)
    three = SegmentMotion([[0.0, 0.0]], [0, 3, 3], [0.04, 0.04, 0.04], [2e-3, 2.4e-3, 2.8e-3])
    selection.evaluate(np.array([0]), three)
    assert len(selection.unsolved()) == 1


def scene_of(plane_at, seed, rings=2):
    rows = np.arange(-rings, rings + 1)
    sites = [(a + b / 2, np.sqrt(0.75) * b) for a in rows for b in rows if abs(a + b) <= rings]
    plane = plane_at(10.4 * np.array(sites))
    rng, pairs = np.random.default_rng(seed), neighbour_pairs(plane)

    def clear():
        angles, again = np.zeros((plane.n, 2)), np.arange(plane.n)
        while len(again):
            angles[again] = rng.uniform([-3.0, 0.5], [3.0, 3.1], (len(again), 2))
            again = np.unique(pairs[sampled_gaps(plane, pairs, angles[..., None])[:, 0] < 0.3, 0])
        return angles

    return plane, clear(), clear()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("most", [2, 15])
def test_dense_planes_on_curved_paths_are_certified(plane_at, seed, most):
    plane, start, goal = scene_of(plane_at, seed)
    trajectory = pushed_apart(plane, start, goal)
    options = DiscretizeOptions(max_segments=most)
    result = discretize(plane, trajectory, UNITS, SAFETY, options=options)
    motion = result.wire.decoded()
    assert result.certificate.ok and certify(plane, motion, SAFETY).ok
    assert motion.counts.max() <= most
    going = result.reason == Reason.OK
    assert going.mean() > 0.8
    assert not motion.counts[~going].any()
    np.testing.assert_allclose(motion.end[going], trajectory.end[going], rtol=0, atol=2e-4)


def test_a_robot_that_returns_to_its_start_moves_only_where_it_must_make_way(plane_at):
    # The robot swings out and back; without neighbours it rests.
    plane = plane_at([[0.0, 0.0]])
    part = np.linspace(0.0, 1.0, 51)
    angles = np.stack([[np.sin(np.pi * part), 1.0 + 0.0 * part]])
    angles[0, 0, -1] = 0.0
    result = discretize(plane, SampledMotion(2.0 * part, angles), UNITS, SAFETY)
    assert result.reason[0] == Reason.OK and not result.wire.decoded().counts.any()


def test_any_number_of_threads_gives_the_same_bytes(monkeypatch):
    plane = preset("pfs", 60)
    start, goal = (random_problem(plane, np.random.default_rng(seed)).start for seed in range(2))
    trajectory = SampledMotion([0.0, 2.5], np.stack([start, goal], axis=2))  # many pairs collide
    units, calls, wires = WireUnits.for_plane(plane), [], []

    def counted_corridors(*arguments):
        calls.append(thread_count())
        return open_corridors(*arguments)

    monkeypatch.setattr(candidates, "open_corridors", counted_corridors)
    monkeypatch.setattr(candidates, "_LEAST_ROBOTS", 1)
    for count in (1, 2, 3):
        with threads(count):
            wires.append(discretize(plane, trajectory, units, SAFETY).wire.decoded())
    assert calls.count(3) > calls.count(1) > 0  # work was divided
    for wire in wires[1:]:
        for column, other in zip(wires[0].arrays, wire.arrays):
            assert column.tobytes() == other.tobytes()


@pytest.mark.timeout(60)
def test_an_end_that_lies_beyond_a_corridor_ends_the_search_for_a_path():
    # The trajectory ends a little inside of where arm 0 meets arm 1, and the encoder of its resting
    # theta, which may be off by the tolerance, well beyond that.
    plane = preset("desi", 2)
    plane = replace(plane, centers=[[0.0, 0.0], [10.4, 0.0]])
    ends = np.radians([[0.0, 30.0], [180.0, 60.0]])
    thetas = np.linspace(-0.4, 0.4, 400)
    poses = np.tile(ends[:, :, None], len(thetas))
    poses[0, 0] = thetas
    (gaps,) = sampled_gaps(plane, [[0, 1]], poses)
    bound = thetas[np.flatnonzero((gaps[:-1] < 0.06) & (gaps[1:] >= 0.06))[0] + 1]
    ends[0, 0] = bound + 0.05
    begins = np.radians([[0.0, 170.0], [100.0, 170.0]])
    begins[0, 0] = ends[0, 0]
    path = np.stack([begins, 0.5 * (begins + ends), ends], axis=-1)
    start = UNITS.to_counts(begins - [[0.1, 0.0], [0.0, 0.0]])
    trajectory, options = (
        SampledMotion([0.0, 1.0, 2.0], path), DiscretizeOptions(start_tolerance_rad=0.2)
    )  # fmt: skip
    plan = SegmentPlan(plane, UNITS, start, SAFETY, 3.0)
    made = candidates.Candidates(plan, start, trajectory, options)
    plan.assign(np.array([1]), made.straight(np.array([1])))
    for joint in range(2):
        _, found = made.along_trajectory(np.array([0]), plan.motion, plan.most_required_mm, joint)
        assert not found.any()
