# SPDX-License-Identifier: Apache-2.0
"""The planner of motors with listed speeds: its moves, its timetable, its plans."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import SegmentMotion, preset
from fiber_core.drive import rules_broken
from fiber_core.drive.least_time import least_time_s
from fiber_core.drive.named import with_drive
from fiber_core.fields import random_field, random_problem
from fiber_core.kinematics import forward
from fiber_core.wire_units import WireUnits
from fiber_planner import PlannerError, ScheduledParameters, ScheduledPlanner
from fiber_planner.scheduled.moves import motors_of_plane
from fiber_planner.scheduled.orders import legs_by_way_of, segments_of
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
    turn = units.to_counts(np.deg2rad(rng.uniform(-150.0, 150.0, (_N, 2))))
    turn[:10] //= 100  # some shorter than the least move at full speed
    turn[10] = 0
    via = units.to_counts(np.deg2rad(rng.uniform(10.0, 60.0, _N))) * by_way
    legs = legs_by_way_of(motors, rows, turn, via)
    # each leg behind the one before it
    starts = np.cumsum(legs.on, axis=1) - legs.on
    motion = orders_of(plane, units, legs, starts, np.zeros((_N, 2), dtype=np.int64))
    assert not rules_broken(plane.drive, motion).any()
    ends = units.to_counts(motion.end)
    assert (ends == legs.turn).all()
    creep = motors.creep.max(axis=2)
    assert (np.abs(ends - turn) <= creep // 2 + 1).all()
    assert not motion.moves[10] or by_way
    if not by_way:
        least = least_time_s(plane.drive, plane.speeds, motion.end[:, None])[:, 0]
        on = np.stack([legs.on[:, 1:3].sum(axis=1), legs.on[:, 3:].sum(axis=1)], axis=1)
        longer = on * units.tick_s - least
        # a tick of each move, and up to a tick at full speed, in creep: a run is whole ticks long
        assert longer.min() > -units.tick_s
        tick_of_creep = units.tick_s * motors.run.max(axis=2) / motors.creep.min(axis=2)
        assert (longer < tick_of_creep + 5 * units.tick_s).all()


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
        assert on[i, 2] == 0 or starts[i, 2] >= ends[1] or on[i, 1] == 0
        assert on[i, 4] == 0 or starts[i, 4] >= ends[3] or on[i, 3] == 0
        assert on[i, 3] == 0 or starts[i, 3] >= ends[0] or on[i, 0] == 0
    assert (counted == table.on).all() and counted.max() == 4
    # new legs in place of the present ones are refused where they do not fit
    rows = np.flatnonzero(fits)[:3]
    too_long = np.full((3, LEGS), 40)
    early = np.zeros((3, LEGS), dtype=np.int64)
    assert not table.put(rows, early, too_long, starts[rows], on[rows]).any()
    assert (counted == table.on).all()
    table.add(rows, starts[rows], on[rows], -1)
    assert table.on.sum() == counted.sum() - on[rows].sum()


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
