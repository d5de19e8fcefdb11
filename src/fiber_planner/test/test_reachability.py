# SPDX-License-Identifier: Apache-2.0
"""Reachability, which skips points and cells, agrees with a grid of measured cells."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from fiber_core import kinematics
from fiber_core.clearance import gaps, levers_of, neighbour_pairs, sampled_gaps
from fiber_core.fields import random_problem
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_planner.direct import reachable
from fiber_planner.direct.reachability import _BLOCK, _CELL_RAD, _MEASURED_MM

EVERYWHERE = np.ones((3, 3))  # cells touch at their corners too


def _problem(robots, seed):
    # every second robot stands still; targets lie anywhere, so that many are closed off
    plane = preset("desi_outlines", robots)
    rng = np.random.default_rng(seed)
    limits = plane.limits.copy()
    limits[:, 0] = np.deg2rad([-45.0, 45.0]) + rng.uniform(-np.pi, np.pi, (robots, 1))
    plane = replace(plane, limits=limits, enabled=rng.random(robots) < 0.5)
    start = random_problem(plane, rng).start
    ends = rng.uniform(limits[..., 0], limits[..., 1])
    return Problem(plane, start, kinematics.forward(plane, ends)[1])


def _slack(problem, i, angles, margin_mm):
    # least gap of robot i to static bodies, less what it has to keep, at many angles, (k, 2)
    plane = problem.plane
    pairs = neighbour_pairs(plane)
    pairs = pairs[(pairs == i).any(axis=1)]
    other = np.where(pairs[:, 0] == i, pairs[:, 1], pairs[:, 0])
    pairs = pairs[(other >= plane.n) | ~plane.enabled[np.minimum(other, plane.n - 1)]]
    if not len(pairs):
        return np.full(len(angles), np.inf)
    here = gaps(plane, pairs, problem.start)
    keep = np.where(here >= margin_mm, margin_mm, here - _MEASURED_MM)
    near = np.append(other[other < plane.n], i)
    poses = np.zeros((plane.n, 2, len(angles)))
    poses[near] = problem.start[near, :, None]
    poses[i] = angles.T
    return (sampled_gaps(plane, pairs, poses) - keep[:, None]).min(axis=0)


def _by_every_cell(problem, i, margin_mm):
    plane, lever, start = problem.plane, levers_of(problem.plane)[i], problem.start[i]
    options, valid = (each[i] for each in kinematics.inverse(plane, problem.targets))
    ends = options[valid]
    ends = ends[_slack(problem, i, ends, margin_mm) >= 0.0] if len(ends) else ends
    low, high = np.minimum(plane.limits[i, :, 0], start), np.maximum(plane.limits[i, :, 1], start)
    count = _BLOCK * np.maximum(1, np.ceil((high - low) / (_BLOCK * _CELL_RAD))).astype(int)
    size = (high - low) / count

    def cell(angles):
        return tuple(np.clip(((angles - low) / size).astype(int), 0, count - 1))

    middles = [low[j] + (np.arange(count[j]) + 0.5) * size[j] for j in range(2)]
    every = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 2)
    corner = 0.5 * (size[0] * lever[0] + size[1] * lever[1])
    is_open = (_slack(problem, i, every, margin_mm) >= -corner).reshape(count)
    is_open[cell(start)] = True
    part, _ = ndimage.label(is_open, EVERYWHERE)
    return any(part[cell(end)] == part[cell(start)] for end in ends)


def test_a_robot_is_reachable_where_measured_cells_lead_to_its_target():
    problem = _problem(16, 0)
    plane, margin_mm = problem.plane, 0.4  # narrow passages
    found = reachable(problem, neighbour_pairs(plane), margin_mm)
    rows = np.flatnonzero(plane.enabled & kinematics.inverse(plane, problem.targets)[1].any(axis=1))
    expected = [_by_every_cell(problem, i, margin_mm) for i in rows]
    assert found[rows].tolist() == expected
    assert 0 < sum(expected) < len(rows)
