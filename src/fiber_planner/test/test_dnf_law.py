# SPDX-License-Identifier: Apache-2.0
"""The navigation function: its gradient, its sign, its barrier, its steps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiber_core import kinematics
from fiber_core.clearance import neighbour_pairs, sampled_gaps
from fiber_core.presets import preset
from fiber_planner.dnf import DnfParameters
from fiber_planner.dnf.arm_repulsion import ArmNeighbours
from fiber_planner.dnf.integrator import arm_points, longest_step
from fiber_planner.dnf.navigation_function import ControlLaw, Swarm, attraction, repulsion
from fiber_planner.dnf.tip_repulsion import SHARE, TipNeighbours

SMALL = 1e-6  # [rad] step of the finite differences


def minus_gradient(potential, angles):
    """Minus the derivative of each robot's potential by its own joints, by central differences."""
    slope = np.zeros_like(angles)
    for i, joint in np.ndindex(angles.shape):
        there = [angles.copy(), angles.copy()]
        there[0][i, joint] -= SMALL
        there[1][i, joint] += SMALL
        slope[i, joint] = (potential(there[0])[i] - potential(there[1])[i]) / (2 * SMALL)
    return slope


def assert_is_gradient(found, potential, angles):
    want = minus_gradient(potential, angles)
    assert np.abs(want).max() > 0.1
    np.testing.assert_allclose(found, want, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("sign", ["corrected", "printed"])
@pytest.mark.parametrize("name", ["pfs", "moons"])
def test_push_of_the_tips_is_minus_the_gradient(name, sign, random_field):
    plane = replace(preset(name, 30), obstacles=[[3.0, 4.0, 2.0]])
    angles = np.array(random_field(name, 30, seed=1).start)
    law = ControlLaw.of(plane, DnfParameters(sign=sign))
    neighbours = TipNeighbours(plane, law)

    def push(at):
        return neighbours.repel(at, *kinematics.forward(plane, at), np.zeros(plane.n))

    assert_is_gradient(push(angles)[1], lambda at: push(at)[0], angles)


@pytest.mark.parametrize("name", ["desi", "desi_outlines", "sdss_v"])
def test_push_of_the_arms_is_minus_the_gradient(name, random_field):
    problem = random_field(name, 30, seed=2)
    plane = replace(problem.plane, obstacles=[[3.0, 40.0, 2.0]])
    law = ControlLaw.of(plane, DnfParameters())
    far = np.array(problem.start)
    neighbours = ArmNeighbours(plane, problem.start, far, law, margin_mm=0.05)
    neighbours._outer[:] = law.outer  # not narrowed to the gaps of the goals

    def push(at):
        return neighbours.repel(at, *kinematics.forward(plane, at), np.zeros(plane.n))

    assert_is_gradient(push(far)[1], lambda at: push(at)[0], far)


@pytest.mark.parametrize("mode", ["joint", "tip"])
@pytest.mark.parametrize("away", [1.0, 0.05])
def test_attraction_is_minus_the_gradient(mode, away, random_field):
    plane = preset("paper", 20)
    rng = np.random.default_rng(3)
    goal = rng.uniform(-2, 2, (20, 2))
    angles = goal + away * rng.uniform(-1, 1, (20, 2))
    law = ControlLaw.of(plane, DnfParameters(attraction=mode))
    swarm = Swarm.of(plane, angles, goal, plane.enabled)

    def pull(at):
        return np.array([attraction(i, at, *arm_points(at, swarm), swarm, law) for i in range(20)])

    assert_is_gradient(pull(angles)[:, 1:], lambda at: pull(at)[:, 0], angles)


@pytest.mark.parametrize("r", [2.05, 2.5, 3.0, 3.9])
def test_repulsion_is_the_formula_of_the_paper_with_the_sign_turned(r):
    outer, inner = 4.0, 2.0
    printed = 0.05 * min(0.0, (r**2 - outer**2) / (r**2 - inner**2))
    value, slope = repulsion(r * r, 0.05, outer, inner)
    assert value == pytest.approx(-printed, rel=1e-12) and value > 0 and slope < 0
    value, slope = repulsion(r * r, -0.05, outer, inner)
    assert value == pytest.approx(printed, rel=1e-12) and value < 0 and slope > 0
    # field.md section 1: the gradient by q_i is -2 lambda2 (D^2 - d^2) (q_i - q_j) / (r^2 - d^2)^2
    by_r = 2 * r * repulsion(r * r, 0.05, outer, inner)[1]
    assert by_r == pytest.approx(-0.1 * (outer**2 - inner**2) * r / (r**2 - inner**2) ** 2)


def test_repulsion_is_finite_everywhere_and_parts_what_is_too_near():
    for square in (0.0, 1.0, 4.0, 4.0 + 1e-12, 16.0, 100.0):
        value, slope = repulsion(square, 0.05, 4.0, 2.0)
        assert np.isfinite([value, slope]).all()
        assert (slope < 0) == (square < 16.0)


def test_places_are_the_forward_kinematics():
    plane = preset("moons", 20)
    angles = np.random.default_rng(0).uniform(-3, 3, (20, 2))
    swarm = Swarm.of(plane, angles, angles, plane.enabled)
    for ours, theirs in zip(arm_points(angles, swarm), kinematics.forward(plane, angles)):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-12)


@given(
    closing=st.floats(-1, 1), bend=st.floats(0, 1), allowed=st.floats(-0.1, 1), part=st.floats(0, 1)
)
def test_no_part_of_the_longest_step_uses_more_than_allowed(closing, bend, allowed, part):
    factor = longest_step(closing, bend, allowed)
    assert 0.0 <= factor <= 1.0
    f = part * factor
    assert f * closing + 0.5 * f * f * bend <= max(allowed, 0.0) + 1e-12
    longer = min(1.0, factor * 1.01 + 1e-6)
    if factor < 1.0 and allowed > 0:  # and it is the longest
        assert longer * closing + 0.5 * longer * longer * bend > allowed


def moved_alone(angles, step, i):
    """Angles while robot i alone makes its step, shape (n, 2, 20)."""
    path = np.repeat(np.array(angles)[..., None], 20, axis=-1)
    path[i] += step[i][:, None] * np.linspace(0, 1, 20)
    return path


@pytest.mark.parametrize("reach", [0.3, 1.0])
def test_one_robots_turn_uses_up_no_more_than_its_share_of_a_distance(reach, random_field, tips_at):
    # turns so long that their arc counts as much as their chord
    problem = random_field("pfs", 40, seed=4)
    plane, start = problem.plane, problem.start
    law = ControlLaw.of(plane, DnfParameters())
    neighbours = TipNeighbours(plane, law)
    _, _, contacts = neighbours.repel(start, *kinematics.forward(plane, start), np.zeros(plane.n))
    tightest = 1.0
    for seed in range(8):
        step = np.random.default_rng(seed).uniform(-reach, reach, start.shape)
        factor, _ = neighbours.step_fractions(step, contacts)
        for i in range(plane.n):
            x, y = tips_at(plane, moved_alone(start, factor[:, None] * step, i))
            apart = np.delete(np.hypot(x - x[i], y - y[i]), i, axis=0)
            left = (apart - law.inner) / (apart[:, :1] - law.inner)
            assert left.min() > 1 - SHARE - 1e-9
            tightest = min(tightest, left.min())
    assert tightest < 0.7  # and it is not all caution


@pytest.mark.parametrize("name", ["desi", "desi_outlines", "sdss_v"])
@pytest.mark.parametrize("reach", [0.3, 1.0])
def test_one_robots_turn_uses_up_no_more_than_its_share_of_a_gap(name, reach, random_field):
    problem = random_field(name, 30, seed=5)
    plane, start = problem.plane, problem.start
    law = ControlLaw.of(plane, DnfParameters(dt_s=2 * reach / plane.speeds.min()))
    neighbours = ArmNeighbours(plane, start, start, law, margin_mm=0.1)
    _, _, contacts = neighbours.repel(start, *kinematics.forward(plane, start), np.zeros(plane.n))
    pairs = neighbour_pairs(plane)
    tightest = 1.0
    for seed in range(4):
        step = np.random.default_rng(seed).uniform(-reach, reach, start.shape)
        factor, _ = neighbours.step_fractions(step, contacts)
        for i in range(plane.n):
            with_i = pairs[(pairs == i).any(axis=1)]
            gaps = sampled_gaps(plane, with_i, moved_alone(start, factor[:, None] * step, i))
            left = (gaps - 0.1) / (gaps[:, :1] - 0.1)
            assert left.min() > 1 - SHARE - 1e-9
            tightest = min(tightest, left.min())
    assert tightest < 0.7
