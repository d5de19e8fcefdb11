# SPDX-License-Identifier: Apache-2.0
"""Laws of the direct planner: the certificate is the judge of every plan."""

import itertools
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.clearance import certify, gaps, neighbour_pairs
from fiber_core.fields import random_problem
from fiber_core.metrics import lower_bound_s
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Reason
from fiber_core.presets import PRESETS, plane_from, preset
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_formats import read_layout
from fiber_planner import make_planner
from fiber_planner.direct import DirectParameters, DirectPlanner, straight_pieces

_DATA = Path(os.environ.get("FIBER_DATA", Path(__file__).parents[4] / "shared" / "data"))


def _judge(problem, planned):
    # what holds of every plan, whatever became of each robot
    plane, motion = problem.plane, straight_pieces(planned.motion)
    certificate = certify(plane, motion, DirectParameters().safety)
    assert not certificate.limits_broken.any()
    assert not certificate.moved_disabled.any()
    assert not certificate.unsafe.any(), certificate.pairs[certificate.unsafe]
    assert np.array_equal(planned.motion.start, problem.start)
    ok = planned.reason == Reason.OK
    assert not (ok & ~problem.asked).any()
    away = np.hypot(*(kinematics.forward(plane, motion.end)[1] - problem.targets)[ok].T)
    assert (away < 2e-3).all()
    return motion, ok


def _row_of_robots(theta_start, theta_goal, phi_start=0.0, phi_goal=0.0, **columns):
    # DESI-like robots 10.4 mm apart on the x axis, free to turn; angles in degrees
    n = len(theta_start)
    centers = np.stack([10.4 * np.arange(n), np.zeros(n)], axis=1)
    limits = np.broadcast_to(np.deg2rad([[-360.0, 360.0], [0.0, 180.0]]), (n, 2, 2))
    plane = plane_from(
        PRESETS["desi"], np.arange(n), centers, **{"limits": limits, "spacing_mm": 0.0, **columns}
    )
    start = np.deg2rad(np.stack(np.broadcast_arrays(theta_start, phi_start), axis=1))
    goal = np.deg2rad(np.stack(np.broadcast_arrays(theta_goal, phi_goal), axis=1))
    return Problem(plane, start, kinematics.forward(plane, goal)[1]), goal


@pytest.mark.parametrize(
    "name, robots, seed, ratio",
    [
        ("desi", 300, 1, 1.05),
        ("desi", 300, 2, 1.05),
        ("pfs", 200, 3, 1.05),
        ("pfs", 200, 4, 1.05),
        ("desi_outlines", 90, 5, 1.10),
        ("lamost", 150, 6, 1.25),
        ("paper", 150, 7, 1.05),
    ],
)
def test_all_robots_arrive_as_fast_as_the_slowest_alone(name, robots, seed, ratio):
    problem = random_problem(preset(name, robots), np.random.default_rng(seed))
    planned = DirectPlanner().plan(problem)
    motion, ok = _judge(problem, planned)
    assert ok.all()
    assert motion.makespan_s <= ratio * lower_bound_s(problem)
    moving = motion.counts[motion.counts > 0]
    assert np.mean(moving <= 2) > 0.9


@pytest.mark.parametrize(
    "name, robots, seed", [("sdss_v", 91, 1), ("sdss_v", 91, 2), ("moons", 60, 3)]
)
def test_heavy_overlap_is_solved_by_folding(name, robots, seed):
    # every point is within reach of three robots: straight moves alone leave many in conflict
    problem = random_problem(preset(name, robots), np.random.default_rng(seed))
    motion, ok = _judge(problem, DirectPlanner().plan(problem))
    assert ok.all()
    assert motion.makespan_s <= 1.8 * lower_bound_s(problem)


def test_straight_moves_alone_would_collide():
    # the reference: straight motions, no local search
    problem = random_problem(preset("pfs", 200), np.random.default_rng(3))
    planned = DirectPlanner().plan(problem)
    share = np.linspace(0.0, 1.0, len(planned.motion.time_s))
    straight = replace(
        planned.motion,
        angles=problem.start[..., None] + (planned.goal - problem.start)[..., None] * share,
    )
    certificate = certify(problem.plane, straight_pieces(straight), DirectParameters().safety)
    assert certificate.unsafe.any()


_HARD = {
    "head on": ((30, 210), (-30, 150), 0, 0),
    "three in a row pass each other": ((30, 210, 210), (-30, 330, 150), 0, 0),
    "singular phi, stretched to folded": ((30, 210), (-30, 150), 0, 180),
    "singular phi, folded to stretched": ((0, 180), (60, 120), 180, 0),
    "goals on stops": ((-300, 300), (360, -360), 90, 180),
    "change places in the gap": ((20, 200, 20), (-20, 160, -20), 10, 10),
}


@pytest.mark.parametrize("case", _HARD)
def test_hard_cases(case):
    problem, goal = _row_of_robots(*_HARD[case])
    pairs = neighbour_pairs(problem.plane)
    assert (gaps(problem.plane, pairs, problem.start) > 0.1).all()
    assert (gaps(problem.plane, pairs, goal) > 0.1).all()
    motion, ok = _judge(problem, DirectPlanner().plan(problem))
    assert ok.all()


def _tips_facing(theta_start, gap_mm, others=()):
    # two robots that end with their tips a gap apart on the x axis, and more that turn back
    turns = (*theta_start, *others)
    problem, goal = _row_of_robots(turns, [0] * len(turns), 0, 0)
    bend = np.arccos((10.4 - 2.0 - gap_mm) / 12.0)
    goal[:2] = [[-bend, 2 * bend], [np.pi - bend, 2 * bend]]
    assert gaps(problem.plane, [[0, 1]], goal)[0] == pytest.approx(gap_mm, abs=1e-9)
    return replace(problem, targets=kinematics.forward(problem.plane, goal)[1])


def _required_at_full_speed(plane):
    n = plane.n
    half_turn = SegmentMotion(
        np.zeros((n, 2)),
        np.arange(2 * n + 1),
        np.full(2 * n, np.pi / plane.speeds[0, 0]),
        plane.speeds.ravel(),
    )
    return DirectParameters().safety.required_mm(plane, half_turn, np.array([[0, 1]]))[0]


def test_targets_at_exactly_the_least_distance():
    required = _required_at_full_speed(_row_of_robots((90, 90), (0, 180))[0].plane)
    problem = _tips_facing((90, 90), required)
    _, ok = _judge(problem, DirectPlanner().plan(problem))
    assert ok.all()


def test_slow_robots_may_end_nearer_than_fast_ones_could():
    # the third one has far to go, the two that face each other have all that time
    gap_mm = 0.12
    problem = _tips_facing((-20, 160), gap_mm, others=(200,))
    assert gap_mm < _required_at_full_speed(problem.plane)
    motion, ok = _judge(problem, DirectPlanner().plan(problem))
    assert ok.all()
    assert motion.makespan_s <= 1.01 * lower_bound_s(problem)


def _boxed_in():
    # a robot among six disabled ones that all point at it
    ring = np.deg2rad(60.0 * np.arange(6))
    centers = np.vstack([[0.0, 0.0], 10.4 * np.stack([np.cos(ring), np.sin(ring)], axis=1)])
    plane = plane_from(
        PRESETS["desi"],
        np.arange(7),
        centers,
        enabled=[True] + 6 * [False],
        limits=np.broadcast_to(np.deg2rad([[-360.0, 360.0], [0.0, 180.0]]), (7, 2, 2)),
    )
    start = np.vstack([[np.pi / 6, np.pi], np.stack([ring - np.pi, np.zeros(6)], axis=1)])
    return plane, start


def test_boxed_in_by_disabled_neighbours():
    plane, start = _boxed_in()
    targets = np.full((7, 2), np.nan)
    targets[0] = [5.0, 0.3]  # under the arm of robot 1
    planned = DirectPlanner().plan(Problem(plane, start, targets))
    _judge(Problem(plane, start, targets), planned)
    assert planned.reason[0] == Reason.GOAL_BLOCKED
    folded = np.where(np.arange(7)[:, None] == 0, [np.pi / 6 + 0.1, np.pi - 0.2], start)
    targets[0] = kinematics.forward(plane, folded)[1][0]  # free, in the middle
    planned = DirectPlanner().plan(Problem(plane, start, targets))
    _, ok = _judge(Problem(plane, start, targets), planned)
    assert ok[0]


def test_a_robot_that_cannot_arrive_costs_no_other_robot_its_target():
    problem = random_problem(preset("desi", 120), np.random.default_rng(8))
    plane = problem.plane.with_enabled(np.random.default_rng(9).random(120) > 0.15)
    problem = random_problem(plane, np.random.default_rng(10))
    planned = DirectPlanner().plan(problem)
    _, ok = _judge(problem, planned)
    assert set(planned.reason) <= {
        Reason.OK, Reason.NO_TARGET, Reason.GOAL_BLOCKED, Reason.NOT_CONVERGED
    }  # fmt: skip
    assert ok.sum() >= 0.97 * problem.asked.sum()


def test_a_robot_without_a_target_makes_way():
    # robot 1 stands where robot 0 has to go and is asked nothing
    problem, _ = _row_of_robots((90, 180), (0, 180), 0, 0)
    targets = problem.targets.copy()
    targets[1] = np.nan
    problem = Problem(problem.plane, problem.start, targets)
    planned = DirectPlanner().plan(problem)
    motion, ok = _judge(problem, planned)
    assert ok[0] and planned.reason[1] == Reason.NO_TARGET
    assert np.abs(motion.end[1] - problem.start[1]).max() > 0.1


def test_a_small_change_moves_one_robot():
    plane = preset("desi", 200)
    problem = random_problem(plane, np.random.default_rng(11))
    _, tips = kinematics.forward(plane, problem.start)
    targets = tips.copy()
    angles = problem.start[17] + [0.02, 0.0]
    targets[17] = kinematics.forward(
        plane, np.where(np.arange(200)[:, None] == 17, angles, problem.start)
    )[1][17]
    change = Problem(plane, problem.start, targets)
    motion, ok = _judge(change, DirectPlanner().plan(change))
    assert ok.all()
    assert np.flatnonzero((motion.counts > 0).any(axis=1)).tolist() == [17]
    # four ticks of the wire are the shortest plan
    assert motion.makespan_s <= 4 * WireUnits.for_plane(plane).tick_s
    assert lower_bound_s(change) > WireUnits.for_plane(plane).tick_s


def test_a_robot_outside_its_limits_is_not_moved():
    problem = random_problem(preset("desi", 40), np.random.default_rng(18))
    start = problem.start.copy()
    start[7, 1] = problem.plane.limits[7, 1, 1] + 0.01
    problem = Problem(problem.plane, start, problem.targets)
    planned = DirectPlanner().plan(problem)
    _, ok = _judge(problem, planned)
    assert planned.reason[7] == Reason.START_OUTSIDE_LIMITS
    assert (planned.motion.angles[7] == start[7][:, None]).all()
    assert ok.sum() >= 38


@pytest.mark.parametrize("robots", [0, 1, 2])
def test_planes_of_hardly_any_robots(robots):
    plane = preset("pfs", 2).permuted(np.arange(robots))
    start = np.full((robots, 2), 0.5)
    problem = Problem(plane, start, kinematics.forward(plane, start + [1.0, 0.3])[1])
    motion, ok = _judge(problem, DirectPlanner().plan(problem))
    assert ok.all() and motion.n == robots


def test_no_robot_moves_without_targets():
    plane = preset("desi", 30)
    start = random_problem(plane, np.random.default_rng(12)).start
    planned = DirectPlanner().plan(Problem(plane, start, np.full((30, 2), np.nan)))
    assert planned.motion.makespan_s == 0.0
    assert (planned.reason == Reason.NO_TARGET).all()


def test_permuting_the_robots_permutes_the_plan():
    problem = random_problem(preset("pfs", 150), np.random.default_rng(13))
    plane = problem.plane.with_enabled(np.random.default_rng(14).random(150) > 0.05)
    order = np.random.default_rng(15).permutation(150)
    first = DirectPlanner().plan(Problem(plane, problem.start, problem.targets))
    second = DirectPlanner().plan(
        Problem(plane.permuted(order), problem.start[order], problem.targets[order])
    )
    assert np.array_equal(first.motion.angles[order], second.motion.angles)
    assert np.array_equal(first.reason[order], second.reason)
    assert np.array_equal(first.goal[order], second.goal)


def test_a_pair_that_starts_too_close_never_comes_closer():
    problem, _ = _row_of_robots((0, 180), (90, 90), 0, 0, arms=np.full((2, 2), 2.11))
    plane = problem.plane
    before = gaps(plane, [[0, 1]], problem.start)[0]
    assert before < 0.0
    planned = DirectPlanner().plan(problem)
    _judge(problem, planned)
    certificate = certify(plane, straight_pieces(planned.motion), DirectParameters().safety)
    assert certificate.gap_mm[0] > before - 2e-3
    assert planned.reason.tolist() == [Reason.OK, Reason.TANGLED]
    # it waited for the other; now it can go
    again = Problem(plane, planned.motion.end, problem.targets)
    _, ok = _judge(again, DirectPlanner().plan(again))
    assert ok.all()


def test_the_real_plane_of_2021():
    table = _DATA / "desi_2021-06-25.csv"
    if not table.exists():
        pytest.skip(f"no real focal plane at {table}")
    whole = read_layout(table).plane
    plane = whole.permuted(np.argsort(np.hypot(*(whole.centers - whole.centers[0]).T))[:250])
    problem = random_problem(plane, np.random.default_rng(17))
    planned = DirectPlanner().plan(problem)
    _, ok = _judge(problem, planned)
    assert ok.sum() >= 0.98 * problem.asked.sum()


def _tangled(gap_mm, **columns):
    # robots 0 and 1 face each other tip to tip, a gap apart; robot 2 stands aside
    problem, _ = _row_of_robots((0, 180, 90), (0, 180, 90), 0, 0, **columns)
    plane = problem.plane
    bend = np.arccos((10.4 - 2.0 - gap_mm) / 12.0)
    start = np.array([[-bend, 2 * bend], [np.pi - bend, 2 * bend], [np.pi / 2, 0.0]])
    assert gaps(plane, [[0, 1]], start)[0] == pytest.approx(gap_mm, abs=1e-9)
    return plane, start


def _gap_over_time(plane, motion, times):
    return np.array([gaps(plane, [[0, 1]], motion(t))[0] for t in times])


@pytest.mark.parametrize("gap_mm", [0.02, 0.0, -0.05])
@pytest.mark.parametrize("enabled", [(True, True, True), (True, False, True)])
def test_a_pair_too_close_at_the_start_is_parted_and_reported(gap_mm, enabled):
    # neither is asked to move; robot 2 has somewhere to go
    plane, start = _tangled(gap_mm, enabled=enabled)
    targets = np.full((3, 2), np.nan)
    targets[2] = kinematics.forward(plane, start + [0.0, 1.0])[1][2]
    planned = DirectPlanner().plan(Problem(plane, start, targets))
    _judge(Problem(plane, start, targets), planned)
    assert planned.tangled.tolist() == [[0, 1]]
    assert planned.reason.tolist() == [Reason.NO_TARGET, Reason.NO_TARGET, Reason.OK]
    motion = straight_pieces(planned.motion)
    gap = _gap_over_time(plane, motion, np.linspace(0.0, motion.makespan_s, 400))
    assert gap.min() > gap_mm - 2e-3
    assert gap[-1] > DirectParameters().margin_mm
    apart = np.argmax(gap > DirectParameters().margin_mm)
    assert (gap[apart:] > DirectParameters().margin_mm).all()
    assert apart < 250
    if not enabled[1]:
        assert (planned.motion.angles[1] == start[1][:, None]).all()


def test_a_pair_too_close_that_cannot_part_stays_and_costs_no_other_robot_its_target():
    # both arms are held by their stops
    plane, start = _tangled(0.02)
    stops = np.stack([start, start], axis=2)
    stops[2] = plane.limits[2]
    plane = replace(plane, limits=stops)
    targets = np.full((3, 2), np.nan)
    targets[2] = kinematics.forward(plane, start + [0.0, 1.0])[1][2]
    planned = DirectPlanner().plan(Problem(plane, start, targets))
    assert planned.tangled.tolist() == [[0, 1]]
    assert planned.reason[2] == Reason.OK
    assert (planned.motion.angles[:2] == start[:2, :, None]).all()


@pytest.mark.parametrize(
    "goals_deg", [((-89.7, 40.7), (160.8, 39.2)), ((-68.8, 49.1), (136.7, 43.7))]
)
def test_a_pair_that_starts_close_passes_slowly(goals_deg):
    # Robots 0 and 1 have to pass each other. At full speed they would need more than the gap they
    # start with, so that no profile could ever be free of conflict.
    plane, start = _tangled(0.12)
    plane = replace(plane, centers=plane.centers + [[0.0, 0.0], [0.0, 0.0], [30.0, 0.0]])
    goal = np.vstack([np.deg2rad(goals_deg), start[2] + [np.deg2rad(-340.0), 0.5]])
    problem = Problem(plane, start, kinematics.forward(plane, goal)[1])
    planned = DirectPlanner().plan(problem)
    motion, ok = _judge(problem, planned)
    assert ok.all() and not len(planned.tangled)
    assert motion.makespan_s <= 1.25 * lower_bound_s(problem)


def test_no_robot_is_tangled_in_a_valid_field():
    problem = random_problem(preset("desi", 60), np.random.default_rng(20))
    assert len(DirectPlanner().plan(problem).tangled) == 0


def test_a_budget_ends_the_search_with_what_is_certified_so_far():
    # the clock moves on by a second whenever it is looked at
    problem = random_problem(preset("sdss_v", 37), np.random.default_rng(21))
    arrived = []
    for budget_s in (0.0, 20.0, 1e9):
        clock = map(float, itertools.count()).__next__
        planned = DirectPlanner(DirectParameters(budget_s=budget_s), clock).plan(problem)
        _, ok = _judge(problem, planned)
        arrived.append(int(ok.sum()))
        assert clock() < 1000.0 or arrived[-1] == 37
    assert arrived[0] < arrived[1] <= arrived[2] == 37


@pytest.mark.parametrize("seed", [3, 16, 22])
def test_one_robot_that_is_stuck_at_a_wall_does_not_lengthen_the_motion_of_all(seed):
    problem = random_problem(preset("spec_s5", 756), np.random.default_rng(seed))
    plan = make_planner("direct").plan(problem)
    assert (plan.reason == Reason.OK).all()
    # 1.27, 1.27 and 1.43 where robots at walls are tried as often as all others
    assert plan.motion.makespan_s <= 1.1 * lower_bound_s(problem)


@pytest.mark.parametrize("seed", [100, 101])
def test_a_pair_that_has_to_fold_does_not_lengthen_the_motion_of_all(seed):
    problem = random_problem(preset("wst_mixed", 1200), np.random.default_rng(seed))
    plan = make_planner("direct").plan(problem)
    assert (plan.reason == Reason.OK).all()
    # 1.42 and 1.41 where arms fold from 1.4 times the bound on only
    assert plan.motion.makespan_s <= 1.2 * lower_bound_s(problem)
