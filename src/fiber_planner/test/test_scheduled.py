# SPDX-License-Identifier: Apache-2.0
"""The planner of motors with listed speeds: its moves, its timetable, its plans."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import SegmentMotion, preset
from fiber_core.clearance import Safety
from fiber_core.drive import Drive, motors_allowed, rules_broken
from fiber_core.drive.least_time import least_time_s
from fiber_core.drive.named import with_drive
from fiber_core.fields import random_field, random_problem
from fiber_core.kinematics import forward
from fiber_core.metrics import power_bound_s
from fiber_core.outcomes import Reason
from fiber_core.presets import PRESETS, plane_from
from fiber_core.problem import Problem
from fiber_core.wire_units import WireUnits
from fiber_planner import (
    DirectParameters,
    PlannerError,
    ScheduledParameters,
    ScheduledPlanner,
    StraightPlanner,
)
from fiber_planner.direct.scene import scene_of
from fiber_planner.pair_bound import pair_bound
from fiber_planner.scheduled.conflicts import Conflicts
from fiber_planner.scheduled.moves import jogs, motors_of_plane
from fiber_planner.scheduled.orders import curves_of, legs_by_way_of, segments_of
from fiber_planner.scheduled.timetable import LEGS, Timetable

_N = 40


@pytest.fixture(scope="module")
def plane():
    return with_drive(preset("desi_petals", _N), "desi", motors_on=0.55)


def orders_of(plane, units, legs, starts, start):
    offsets, ticks, velocity = segments_of(legs, starts)
    return SegmentMotion(
        units.to_angles(start), offsets, ticks * units.tick_s, velocity * units.velocity_rad_s
    )


@pytest.mark.parametrize("by_way", [False, True])
def test_moves_obey_the_rules_and_end_where_they_should_in_nearly_the_least_time(plane, by_way):
    units, rng = WireUnits.for_plane(plane), np.random.default_rng(1)
    motors, rows = motors_of_plane(plane, units), np.arange(_N)
    # far from the stops
    motors = replace(motors, ranges=motors.ranges + np.array([-(1 << 40), 1 << 40]))
    start = np.zeros((_N, 2), dtype=np.int64)
    turn = units.to_counts(np.deg2rad(rng.uniform(-150.0, 150.0, (_N, 2))))
    turn[:10] //= 100  # some shorter than the least move at full speed
    turn[10:20] //= 40
    turn[20] = 0
    via = jogs(motors, rows, turn)
    assert (via[10:20] != 0).sum() > 10 and not via[20].any()
    if by_way:
        via[:, 1] = units.to_counts(np.deg2rad(rng.uniform(10.0, 60.0, _N)))
    legs = legs_by_way_of(motors, rows, start, turn, via)
    assert legs.possible.all()
    # each leg behind the one before it
    starts = np.cumsum(legs.on, axis=1) - legs.on
    motion = orders_of(plane, units, legs, starts, start)
    assert len(rules_broken(plane.drive, motion)) == 0
    ends = units.to_counts(motion.end)
    assert (ends == legs.turn).all()
    creep = motors.creep.max(axis=2)
    assert (np.abs(ends - turn) <= creep // 2 + 1).all()
    assert not motion.moves[20] or by_way
    if not by_way:
        least = least_time_s(plane.drive, plane.speeds, motion.end[:, None])[:, 0]
        on = np.stack([legs.on[:, :3].sum(axis=1), legs.on[:, 3:].sum(axis=1)], axis=1)
        longer = on * units.tick_s - least
        # a tick of each move, and up to a tick at full speed, in creep: a run is whole ticks long
        assert longer.min() > -units.tick_s
        tick_of_creep = units.tick_s * motors.run.max(axis=2) / motors.creep.min(axis=2)
        assert (longer < tick_of_creep + 9 * units.tick_s).all()


def test_two_runs_are_quicker_than_creep_to_a_near_goal(plane):
    units = WireUnits.for_plane(plane)
    motors, rows = motors_of_plane(plane, units), np.arange(_N)
    start = motors.ranges.mean(axis=2).astype(np.int64)
    turn = np.full((_N, 2), int(units.to_counts(np.deg2rad(3.0))))
    creeping = legs_by_way_of(motors, rows, start, turn, 0 * turn)
    running = legs_by_way_of(motors, rows, start, turn, jogs(motors, rows, turn))
    saved_s = (creeping.on - running.on).sum(axis=1) * units.tick_s
    # a run of 5 deg and 2 deg back in creep take 0.8 s, two runs less than 0.2 s
    assert (saved_s[(plane.drive.scale == 1.0).all(axis=(1, 2))] > 2 * (0.8 - 0.2)).all()


def test_a_run_on_the_way_that_is_the_whole_turn_still_ends_with_an_approach(plane):
    units = WireUnits.for_plane(plane)
    motors, rows = motors_of_plane(plane, units), np.arange(_N)
    start = motors.ranges.mean(axis=2).astype(np.int64)
    turn = np.stack([np.zeros(_N, dtype=np.int64), 40 * motors.run[:, 1, 1]], axis=1)
    legs = legs_by_way_of(motors, rows, start, turn, turn)
    assert legs.possible.all()
    assert (np.abs(legs.turn - turn) <= motors.creep.max(axis=2) // 2 + 1).all()
    starts = np.cumsum(legs.on, axis=1) - legs.on
    motion = orders_of(plane, units, legs, starts, start)
    assert motion.moves.all() and len(rules_broken(plane.drive, motion)) == 0


def test_no_move_leaves_the_range_of_a_joint(plane):
    units, rng = WireUnits.for_plane(plane), np.random.default_rng(3)
    motors = motors_of_plane(plane, units)
    low, high = np.moveaxis(motors.ranges, -1, 0)
    rows = np.repeat(np.arange(_N), 20)
    # starts and goals next to the stops
    near = units.to_counts(np.deg2rad(rng.uniform(0.0, 8.0, (2, len(rows), 2))))
    ends = np.where(rng.random(near.shape) < 0.5, low[rows] + near, high[rows] - near)
    start, turn = ends[0], ends[1] - ends[0]
    legs = legs_by_way_of(motors, rows, start, turn, jogs(motors, rows, turn))
    assert 0.2 < legs.possible.mean() < 0.9  # an approach needs 3 deg before a stop
    starts = np.cumsum(legs.on, axis=1) - legs.on
    curves = curves_of(plane.drive.of_robots(rows), units, start, legs, starts)
    least, most = np.moveaxis(plane.limits[rows], -1, 0)
    assert (curves.lowest >= least - 1e-9).all() and (curves.highest <= most + 1e-9).all()
    assert not curves.moves[~legs.possible].any()


def test_a_goal_that_no_approach_can_reach_is_told(plane):
    problem = random_problem(plane, np.random.default_rng(0))
    start = problem.start.copy()
    start[0] = plane.limits[0].mean(axis=1)
    goal = start.copy()
    start[0, 0] = plane.limits[0, 0, 1] - np.deg2rad(6.0)
    goal[0, 0] = plane.limits[0, 0, 1] - np.deg2rad(1.0)  # theta's approach comes from above
    targets = np.full((_N, 2), np.nan)
    targets[0] = forward(plane, goal)[1][0]
    found = StraightPlanner().plan(replace(problem, start=start, targets=targets))
    assert found.reason[0] == Reason.OUTSIDE_JOINT_RANGE
    assert (found.motion.angles[:, :, 0] == found.motion.angles[:, :, -1]).all()


def test_pairs_of_different_sectors_are_examined_as_far_apart_as_they_must_stay(plane):
    plane = replace(plane, sector=np.arange(_N) % 2)
    units, start = WireUnits.for_plane(plane), np.zeros((_N, 2), dtype=np.int64)
    slow = Safety(border_stop_skew_s=0.2)
    at_once = Conflicts.of_plane(plane, units, start, Safety(border_stop_skew_s=4e-3), 6.0)
    late = Conflicts.of_plane(plane, units, start, slow, 6.0)
    assert len(late.pairs) > len(at_once.pairs)
    assert late.required_mm.max() > 1.0
    problem = Problem(plane, plane.limits.mean(axis=2), np.full((_N, 2), np.nan))
    wide = DirectParameters(border_stop_skew_s=0.2)
    assert len(scene_of(problem, wide).pairs) > len(scene_of(problem).pairs)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"ramp_s": np.array([0.022, 0.01])}, "approaches without a ramp.* has one of 0.01 s"),
        ({"least_rad": np.deg2rad([4.53, 5.0])}, "the least move of its motor .* is 5 deg"),
        ({"least_rad": np.deg2rad([4.53, 0.1]), "returns": False}, "as little as 0 deg"),
    ],
)
def test_lists_of_speeds_that_it_cannot_plan_with_are_refused(plane, values, words):
    drive = plane.drive
    listed = replace(drive.listed, **values)
    other = replace(plane, drive=Drive(_N, listed=listed, scale=drive.scale))
    problem = random_problem(other, np.random.default_rng(0))
    with pytest.raises(PlannerError, match=words):
        ScheduledPlanner().plan(problem)


@pytest.mark.parametrize("joint", [0, 1])
def test_the_least_move_of_each_joint_counts_with_its_scale(plane, joint):
    scale = np.ones((_N, 2, 2))
    scale[:, joint] = 1.2
    values = {"approach_rad": np.full(2, 0.05), "least_rad": np.array([0.08, 0.05])}
    drive = Drive(_N, listed=replace(plane.drive.listed, **values), scale=scale)
    other = replace(plane, drive=drive)
    with pytest.raises(PlannerError, match=f"and {('theta', 'phi')[joint]} may move as little as"):
        ScheduledPlanner().plan(random_problem(other, np.random.default_rng(0)))


def test_a_timetable_never_has_more_motors_on_than_allowed():
    rng, n = np.random.default_rng(2), 30
    group, ticks = np.arange(n) % 3, 130
    table = Timetable(group, np.full(n, 4), ticks)
    on = rng.integers(0, 20, (n, LEGS))
    starts = np.zeros((n, LEGS), dtype=np.int64)
    fits = table.enter(np.arange(n), on, rng.integers(0, 30, (n, LEGS)), starts)
    assert fits.any() and not fits.all()
    counted = np.zeros((3, ticks), dtype=np.int64)
    for i in np.flatnonzero(fits):
        for leg in range(LEGS):
            counted[group[i], starts[i, leg] : starts[i, leg] + on[i, leg]] += 1
        # legs of a joint follow each other
        ends = starts[i] + on[i]
        for leg in (1, 2, 4, 5):
            assert on[i, leg] == 0 or starts[i, leg] >= ends[leg - 1] or on[i, leg - 1] == 0
    assert (counted == table.on).all() and counted.max() == 4
    # new legs in place of the present ones are refused where they do not fit
    rows = np.flatnonzero(fits)[:3]
    too_long = np.full((3, LEGS), 40)
    early = np.zeros((3, LEGS), dtype=np.int64)
    assert not table.put(rows, early, too_long, starts[rows], on[rows]).any()
    assert (counted == table.on).all()
    assert table.put(rows, starts[rows], 0 * on[rows], starts[rows], on[rows]).all()
    assert table.on.sum() == counted.sum() - on[rows].sum()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_corrections_under_a_cap_are_packed_nearly_as_tight_as_joints_can_be(seed):
    plane = with_drive(preset("desi_petals", 200), "desi", motors_on=0.55)
    units, rng = WireUnits.for_plane(plane), np.random.default_rng(seed)
    drawn = random_field(plane, rng, gap_mm=1.0).problem
    turn_rad = np.deg2rad(
        rng.uniform(0.5, 3.0, (plane.n, 2)) * rng.choice([-1.0, 1.0], (plane.n, 2))
    )
    targets = np.where(plane.enabled[:, None], forward(plane, drawn.start + turn_rad)[1], np.nan)
    found = StraightPlanner().plan(replace(drawn, targets=targets))
    # of two more joints than may turn at once some two turn one after the other (Graham 1969)
    motors, rows = motors_of_plane(plane, units), np.flatnonzero(found.reason == Reason.OK)
    turn = units.to_counts(found.goal) - units.encoder_counts(plane, drawn.start)
    legs = legs_by_way_of(
        motors, rows, units.encoder_counts(plane, drawn.start)[rows], turn[rows],
        jogs(motors, rows, turn[rows]),
    )  # fmt: skip
    lasts = legs.on.reshape(len(rows), 2, LEGS // 2).sum(axis=2)
    for supply in np.unique(plane.supply[rows]):
        of_supply = plane.supply[rows] == supply
        allowed = motors_allowed(plane.supply, plane.drive.motors_on)[rows][of_supply][0]
        longest = np.sort(lasts[of_supply].ravel())[::-1]
        assert len(longest) > allowed
        in_turn = longest[allowed - 1] + longest[allowed]
        assert found.motion.time_s[-1] <= 1.02 * max(in_turn, longest[0]) * units.tick_s


def test_a_timetable_in_which_legs_do_not_fit_grows_by_little_after_its_first_step(monkeypatch):
    plane = with_drive(preset("desi_petals", 200), "desi", motors_on=0.55)
    problem = random_field(plane, np.random.default_rng(2), gap_mm=0.5).problem
    tried, extend = [], Timetable.extend

    def noted(table, ticks):
        tried.append((table.ticks, ticks))
        extend(table, ticks)

    monkeypatch.setattr(Timetable, "extend", noted)
    ScheduledPlanner().plan(problem)
    before, after = np.array(tried).T
    assert len(tried) > 1 and (before[1:] == after[:-1]).all()
    assert after[0] <= np.ceil(1.04 * before[0])
    assert (after[1:] <= np.ceil(1.01 * before[1:])).all()


def test_other_motors_are_refused():
    problem = random_problem(preset("desi", 3), np.random.default_rng(0))
    with pytest.raises(PlannerError, match="for motors with listed speeds.*'ideal'"):
        ScheduledPlanner().plan(problem)
    with pytest.raises(PlannerError, match="slack"):
        ScheduledParameters(slack=-1.0)


@pytest.mark.parametrize("seed", [45, 53, 59])
def test_conflicts_of_robots_that_have_nothing_to_turn_end_the_search(seed):
    plane = with_drive(preset("desi_petals", 40), "desi", motors_on=0.55)
    drawn = random_field(plane, np.random.default_rng(seed), gap_mm=0.075).problem
    targets = forward(plane, drawn.start)[1]
    found = ScheduledPlanner().plan(replace(drawn, targets=targets))
    assert len(found.reason) == 40


@pytest.mark.parametrize(("before_deg", "reached"), [(3.2, True), (2.8, False)])
def test_a_goal_before_a_stop_is_reached_if_its_approach_of_3_deg_fits(before_deg, reached):
    # with one elbow and one turn of the target inside the limits
    limits = np.deg2rad([[[-50.0, 50.0], [0.0, 180.0]]])
    plane = with_drive(plane_from(PRESETS["desi"], [0], [[0.0, 0.0]], limits=limits), "desi")
    goal = np.deg2rad([[50.0 - before_deg, 90.0]])
    problem = Problem(plane, np.deg2rad([[0.0, 120.0]]), forward(plane, goal)[1])
    found = ScheduledPlanner().plan(problem)
    assert (found.reason[0] == Reason.OK) == reached
    assert pair_bound(problem).robots == int(reached)


def test_a_robot_without_a_way_makes_way_for_its_neighbour():
    # robot 0 lies across the only way of robot 1, which cannot fold, and its own target is one that
    # its approach would lead beyond the stop of theta
    limits = np.deg2rad([[[-170.0, 170.0], [0.0, 180.0]], [[85.0, 275.0], [-4.0, 14.0]]])
    plane = plane_from(PRESETS["desi"], np.arange(2), [[0.0, 0.0], [11.0, 0.0]], limits=limits)
    plane = with_drive(plane, "desi")
    start = np.deg2rad([[0.0, 0.0], [90.0, 5.0]])
    goal = np.deg2rad([[169.0, 0.0], [260.0, 5.0]])
    found = ScheduledPlanner().plan(Problem(plane, start, forward(plane, goal)[1]))
    assert found.reason.tolist() == [Reason.OUTSIDE_JOINT_RANGE, Reason.OK]
    assert np.ptp(found.motion.angles[0], axis=1).max() > np.deg2rad(10.0)


def test_gaps_are_those_of_a_motion_as_long_as_the_timetable(plane, monkeypatch):
    lasting_s = []
    of_plane = Conflicts.of_plane

    def seen(*args):
        lasting_s.append(args[-1])
        return of_plane(*args)

    monkeypatch.setattr(Conflicts, "of_plane", seen)
    parameters = ScheduledParameters(slack=1.0, stretch=1.0)  # it is longer than its longest
    problem = random_problem(plane, np.random.default_rng(0))
    makespan_s = ScheduledPlanner(parameters).plan(problem).motion.makespan_s
    assert makespan_s > 1.1 * power_bound_s(problem)
    assert lasting_s[0] >= makespan_s
