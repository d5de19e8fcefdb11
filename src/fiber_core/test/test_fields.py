# SPDX-License-Identifier: Apache-2.0
"""Laws of random fields: valid at both ends, uniform, repeatable, on every instrument."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.stats import kstest

from fiber_core import (
    PRESETS,
    FieldError,
    assign,
    forward,
    inverse,
    plane_from,
    preset,
    random_field,
    random_problem,
)
from fiber_core.clearance import Safety, gaps, neighbour_pairs
from fiber_core.kinematics import fibre_places

DEFAULT_GAP_MM = Safety().margin_mm + 0.1


def places_of(plane, angles):
    """Return the place of the fibre that each target is for, of the tip on a plane without."""
    if not plane.fibre_names:
        return forward(plane, angles)[1]
    return fibre_places(plane, angles)[np.arange(plane.n), plane.fibre]


def check(plane, field, gap_mm, asked):
    problem = field.problem
    plane = problem.plane  # with the fibres that the targets are for
    assert np.array_equal(problem.asked, asked)
    pairs = neighbour_pairs(plane, max(1.0, gap_mm))
    for angles in (problem.start, field.goal):
        assert gaps(plane, pairs, angles).min(initial=np.inf) >= gap_mm - 1e-12
        found, valid = inverse(plane, places_of(plane, angles))
        error = np.where(valid, np.abs(found - angles[:, None]).max(axis=2), np.inf).min(axis=1)
        assert error.max() < 1e-6
    assert np.array_equal(places_of(plane, field.goal)[asked], problem.targets[asked])
    assert np.array_equal(field.goal[~asked], problem.start[~asked])
    tips = forward(plane, field.goal)[1]  # these keep the envelope, whatever the fibres
    apart = cKDTree(tips[asked]).query(tips[asked], k=2)[0][:, 1]
    assert apart.min() >= plane.envelope_mm - 1e-9
    found = assign(plane, problem.start, plane.ids[asked], problem.targets[asked])
    assert np.array_equal(found.accepted, asked)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("seed", range(3))
def test_a_field_is_valid_at_both_ends(name, seed):
    plane = preset(name, 150)
    field = random_field(plane, np.random.default_rng(seed))
    check(plane, field, DEFAULT_GAP_MM, plane.enabled)
    turns = np.abs(field.goal - field.problem.start).max(axis=1)
    assert turns[plane.enabled].min() > 0  # every robot moves


@pytest.mark.parametrize("name", PRESETS)
def test_disabled_and_idle_robots_stay_clear_of_all_others(name):
    rng = np.random.default_rng(5)
    plane = preset(name, 150).with_enabled(rng.random(150) < 0.8)
    discs = plane.centers[:-1:20] + 0.5 * np.diff(plane.centers[:2], axis=0)
    plane = replace(plane, obstacles=np.c_[discs, np.full(len(discs), 0.4)])
    idle = rng.random(150) < 0.2
    field = random_field(plane, rng, gap_mm=0.3, asked=~idle)
    check(plane, field, 0.3, plane.enabled & ~idle)


def test_targets_are_drawn_for_a_given_start():
    plane = preset("desi", 200).with_enabled(np.arange(200) % 7 != 0)
    first = random_field(plane, np.random.default_rng(1))
    second = random_field(plane, np.random.default_rng(2), start=first.goal)
    assert np.array_equal(second.problem.start, first.goal)
    check(plane, second, DEFAULT_GAP_MM, plane.enabled)
    lost = first.goal.copy()
    lost[9, 1] = np.nan
    with pytest.raises(FieldError, match="robot 9: its start") as caught:
        random_field(plane, np.random.default_rng(2), start=lost)
    assert caught.value.ids.tolist() == [9]


def test_a_field_is_drawn_from_a_given_start():
    rng = np.random.default_rng(3)
    plane = preset("sdss_v", 100).with_enabled(rng.random(100) < 0.9)
    first = random_field(plane, rng)
    second = random_field(plane, rng, start=first.goal)
    assert np.array_equal(second.problem.start, first.goal)
    check(plane, second, DEFAULT_GAP_MM, plane.enabled)
    assert np.all(second.goal[plane.enabled] != first.goal[plane.enabled])
    with pytest.raises(FieldError, match="start"):
        random_field(plane, rng, start=first.goal[1:])


def test_the_same_seed_gives_the_same_bytes():
    plane = preset("moons", 100)
    first, second = (random_field(plane, np.random.default_rng(11)) for _ in range(2))
    assert first.problem.start.tobytes() == second.problem.start.tobytes()
    assert first.problem.targets.tobytes() == second.problem.targets.tobytes()
    assert first.goal.tobytes() == second.goal.tobytes()
    other = random_field(plane, np.random.default_rng(12))
    assert np.all(other.problem.start != first.problem.start)
    assert np.all(other.problem.targets != first.problem.targets)
    repeated = random_problem(plane, np.random.default_rng(11))
    assert repeated.targets.tobytes() == first.problem.targets.tobytes()


def test_a_generator_gives_another_field_each_time():
    plane, rng = preset("desi", 30), np.random.default_rng(1)
    assert np.all(random_problem(plane, rng).start != random_problem(plane, rng).start)


def test_tips_elbows_and_turns_are_uniform():
    n = 4000  # without neighbours, no draw is refused
    limits = np.tile(np.deg2rad([[-360.0, 360.0], [-180.0, 180.0]]), (n, 1, 1))
    centers = np.stack([100.0 * np.arange(n), np.zeros(n)], axis=1)
    plane = plane_from(
        PRESETS["desi"], np.arange(n), centers, np.tile([3.0, 2.0], (n, 1)), limits=limits
    )
    field = random_field(plane, np.random.default_rng(21))
    for angles in (field.problem.start, field.goal):
        offset = forward(plane, angles)[1] - centers
        share = ((offset**2).sum(axis=1) - 1.0) / (25.0 - 1.0)  # of the area of the annulus
        assert kstest(share, "uniform").pvalue > 1e-3
        assert kstest(np.arctan2(*offset.T) / (2 * np.pi) + 0.5, "uniform").pvalue > 1e-3
        assert abs(np.mean(angles[:, 1] > 0) - 0.5) < 0.03
        turns = np.floor(angles[:, 0] / np.pi)
        assert np.abs(np.unique(turns, return_counts=True)[1] / n - 0.25).max() < 0.03
    assert abs(np.corrcoef(field.problem.start[:, 0], field.goal[:, 0])[0, 1]) < 0.06


def test_narrow_joint_ranges_are_kept():
    limits = np.tile(np.deg2rad([[10.0, 25.0], [30.0, 50.0]]), (40, 1, 1))
    plane = replace(preset("desi", 40), limits=limits)
    field = random_field(plane, np.random.default_rng(0))
    check(plane, field, DEFAULT_GAP_MM, np.ones(40, dtype=bool))


def test_a_plane_without_space_is_refused_with_the_robots_left():
    plane = preset("desi", 19)
    with pytest.raises(FieldError, match="of 19 robots found no start 9 mm from the") as refusal:
        random_field(plane, np.random.default_rng(0), gap_mm=9.0)
    assert 0 < len(refusal.value.ids) < 19
    assert str(refusal.value.ids[0]) in str(refusal.value)
    locked = np.array(plane.limits)
    locked[7] = 0.5  # no area of its patrol region is left
    with pytest.raises(FieldError) as refusal:
        random_field(replace(plane, limits=locked), np.random.default_rng(0))
    assert refusal.value.ids.tolist() == [7]
    with pytest.raises(FieldError, match="asked"):
        random_field(plane, np.random.default_rng(0), asked=np.ones(18))


def test_the_spacing_of_targets_that_leaves_no_space_is_named():
    plane = replace(preset("desi", 19), envelope_mm=15.0)
    with pytest.raises(FieldError, match="found no goal 0.15 mm from the others, with tips 15 mm"):
        random_field(plane, np.random.default_rng(0))
