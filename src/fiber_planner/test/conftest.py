# SPDX-License-Identifier: Apache-2.0
"""Shared by the tests of this package: small planes, random fields, densely sampled motions."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import settings

from fiber_core.fields import random_problem
from fiber_core.presets import PRESETS, plane_from, preset
from fiber_core.problem import Problem
from fiber_planner.direct.plan_state import PlanState, measure_all
from fiber_planner.direct.scene import scene_of

# New draws in every run: a law holds for all of them, and a failure prints how to repeat it.
settings.register_profile("laws", derandomize=False, database=None, deadline=None, print_blob=True)
settings.load_profile("laws")

_STEPS = 24  # of the profiles of two robots that pass each other


def row_of_robots(places, **columns):
    """DESI-like robots at given places [mm]: arms 3 + 3 mm, D = 4 mm, d = 2 mm, 180 deg/s."""
    plane = preset("desi", len(places))
    columns = {"speeds": np.full((plane.n, 2), np.pi)} | columns
    return replace(plane, centers=np.array(places, dtype=float), **columns)


def field(name, robots, seed, disabled=0.0):
    """Return a random problem on a preset, some of its robots disabled."""
    rng = np.random.default_rng(seed)
    plane = preset(name, robots)
    return random_problem(plane.with_enabled(rng.random(robots) >= disabled), rng)


def dense(motion, sub=10):
    """Return the angles at all samples of a motion and at `sub - 1` instants between, (n, 2, t)."""
    before, after = motion.angles[..., :-1, None], motion.angles[..., 1:, None]
    between = before + np.arange(sub) / sub * (after - before)
    flat = between.reshape(motion.n, 2, -1)
    return np.concatenate([flat, motion.angles[..., -1:]], axis=-1)


def tips_of(plane, angles):
    """Return the tips at many instants [mm]: x and y, both shape (n, t), from angles (n, 2, t)."""
    theta, both = angles[:, 0], angles[:, 0] + angles[:, 1]
    (x, y), (arm1, arm2) = plane.centers.T[..., None], plane.arms.T[..., None]
    return (
        x + arm1 * np.cos(theta) + arm2 * np.cos(both),
        y + arm1 * np.sin(theta) + arm2 * np.sin(both),
    )


def least_tip_distance(plane, angles):
    """Return the least distance of any two tips over all instants of angles (n, 2, t) [mm]."""
    x, y = tips_of(plane, angles)
    least = np.inf
    for i in range(plane.n - 1):
        near = np.linalg.norm(plane.centers[i + 1 :] - plane.centers[i], axis=1)
        others = i + 1 + np.flatnonzero(near < 2 * plane.arms.sum(axis=1).max() + least)
        if len(others):
            least = min(least, np.hypot(x[others] - x[i], y[others] - y[i]).min())
    return least


def passing_robots(rng, required):
    """Two DESI-like robots on profiles of three lines; they pass each other with little between."""
    plane = plane_from(PRESETS["desi"], np.arange(2), [[0.0, 0.0], [10.4, 0.0]])
    ends = np.array([[[-1.2, 0.9], [1.4, 1.1]], [[1.1, 2.3], [3.3, 2.1]]])
    scene = scene_of(Problem(plane, ends[:, 0], np.full((2, 2), np.nan)))
    q = np.empty((2, 2, _STEPS + 1))
    for i, joint in np.ndindex(2, 2):
        s, g = ends[i, :, joint]
        via = s + (g - s) * np.array([0.3, 0.7]) + rng.uniform(-0.3, 0.3, 2)
        q[i, joint] = np.interp(np.arange(_STEPS + 1), [0, 7, 16, _STEPS], [s, *via, g])
    pairs = len(scene.pairs)
    plan = PlanState(
        q, np.zeros(2, dtype=np.int64), np.full(pairs, required), np.full(pairs, required),
        np.zeros(pairs, dtype=np.int64), np.ones(pairs), np.zeros(pairs),
        np.zeros((2, 2), dtype=np.int64), np.zeros(2, dtype=bool), np.ones(2, dtype=bool),
    )  # fmt: skip
    measure_all(scene, plan)
    return scene, plan


@pytest.fixture
def robots():
    return row_of_robots


@pytest.fixture
def random_field():
    return field


@pytest.fixture
def densely():
    return dense


@pytest.fixture
def closest_tips():
    return least_tip_distance


@pytest.fixture
def tips_at():
    return tips_of


@pytest.fixture
def two_robots():
    return passing_robots
