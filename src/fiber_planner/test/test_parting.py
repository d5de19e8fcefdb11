# SPDX-License-Identifier: Apache-2.0
"""Pairs that start too close: which robot leaves, and that it never comes nearer on its way."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.clearance import certify, gaps, pair_gap
from fiber_core.outcomes import Reason
from fiber_core.presets import PRESETS, plane_from
from fiber_core.problem import Problem
from fiber_planner.direct import DirectParameters, DirectPlanner, straight_pieces
from fiber_planner.direct.collision_cost import collision_cost
from fiber_planner.direct.parting import robots_that_wait
from fiber_planner.direct.scene import scene_of

_APART_MM = 10.4
_MARGIN_MM = DirectParameters().margin_mm
_NO_TARGETS = np.full((2, 2), np.nan)


def _tip_to_tip(gap_mm):
    # two robots whose arms are bent, tip to tip on the line between their centres
    plane = plane_from(PRESETS["desi"], np.arange(2), [[0.0, 0.0], [_APART_MM, 0.0]])
    bend = np.arccos((_APART_MM - 2.0 - gap_mm) / 12.0)
    start = np.array([[-bend, 2.0 * bend], [np.pi - bend, 2.0 * bend]])
    assert gaps(plane, [[0, 1]], start)[0] == pytest.approx(gap_mm, abs=1e-9)
    return plane, start


def _only_outwards(plane, start, row):
    # the arm of a robot can do nothing but straighten, which brings its tip nearer
    limits = plane.limits.copy()
    limits[row, 0], limits[row, 1] = start[row, 0], [start[row, 1] - 0.5, start[row, 1]]
    return replace(plane, limits=limits)


def test_no_robot_has_to_wait_where_both_can_part_or_neither_or_all_are_apart():
    plane, start = _tip_to_tip(-0.2)
    assert not robots_that_wait(scene_of(Problem(plane, start, _NO_TARGETS)), _MARGIN_MM).any()
    for row in range(2):
        plane = _only_outwards(plane, start, row)
    assert not robots_that_wait(scene_of(Problem(plane, start, _NO_TARGETS)), _MARGIN_MM).any()
    plane, start = _tip_to_tip(0.2)
    plane = _only_outwards(plane, start, 0)
    assert not robots_that_wait(scene_of(Problem(plane, start, _NO_TARGETS)), _MARGIN_MM).any()


@pytest.mark.parametrize("row", [0, 1])
@pytest.mark.parametrize("gap_mm", [0.02, -0.2])
def test_a_robot_that_can_only_come_nearer_waits_and_the_other_leaves(gap_mm, row):
    plane, start = _tip_to_tip(gap_mm)
    plane = _only_outwards(plane, start, row)
    ends = start + [1.0, 0.3]
    ends[row] = start[row] - [0.0, 0.2]
    problem = Problem(plane, start, kinematics.forward(plane, ends)[1])
    assert robots_that_wait(scene_of(problem), _MARGIN_MM).tolist() == [row == 0, row == 1]
    planned = DirectPlanner().plan(problem)
    motion = straight_pieces(planned.motion)
    assert planned.reason[row] == Reason.TANGLED and planned.reason[1 - row] == Reason.OK
    assert (planned.motion.angles[row] == start[row][:, None]).all()
    assert certify(plane, motion, DirectParameters().safety).ok
    gap = [gaps(plane, [[0, 1]], motion(t))[0] for t in np.linspace(0, motion.makespan_s, 4000)]
    assert min(gap) > gap_mm - 1e-3 and gap[-1] > _MARGIN_MM


def test_where_no_robot_has_a_target_in_reach_nothing_is_searched():
    # a table of another plane took minutes, as pairs that start too close were to part in no time
    plane, start = _tip_to_tip(-0.2)
    problem, tried = Problem(plane, start, np.full((2, 2), 500.0)), []
    planned = DirectPlanner().plan(problem, lambda _, text: tried.append(text))
    assert not tried and (planned.motion.angles == start[:, :, None]).all()
    assert planned.tangled.tolist() == [[0, 1]] and (planned.reason != Reason.OK).all()


def test_a_pair_that_comes_nearer_by_micrometres_before_it_parts_is_in_conflict():
    # the tip passes the line between the centres: nearest there, and soon farther than at first
    plane, start = _tip_to_tip(-0.1)
    start[0, 0] -= 0.025
    scene = scene_of(Problem(plane, start, _NO_TARGETS))
    theta = np.linspace(start[0, 0], start[0, 0] + 1.44, 25)
    q = np.stack([theta, np.full(25, start[0, 1])])
    rests = np.repeat(start[1][:, None], 25, axis=1)
    gap = np.array([pair_gap(scene.bodies, 0, 1, *q[:, k], *start[1]) for k in range(25)])
    fine = np.linspace(theta[0], theta[1], 200)
    dip = gap[0] - min(pair_gap(scene.bodies, 0, 1, t, q[1, 0], *start[1]) for t in fine)
    assert 1e-3 < dip < 1e-2 and (gap[1:] > gap[0]).all()

    def cost(early_mm):
        return collision_cost(
            scene.bodies, scene.lever, 0, 1, q, rests, _MARGIN_MM, early_mm, 10, np.inf
        )[0]

    assert gap[10] > _MARGIN_MM
    assert cost(gap[0]) > 0.0
    assert cost(gap[0] - dip - 1e-3) == 0.0
