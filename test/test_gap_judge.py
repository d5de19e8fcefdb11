# SPDX-License-Identifier: Apache-2.0
"""The independent judge of gaps agrees with the certificate and finds planted contacts."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from fiber_core.clearance import Safety, certify, gaps, neighbour_pairs
from fiber_core.drive.named import with_drive
from fiber_core.presets import preset
from fiber_core.problem import Problem, problem_columns
from fiber_positioners import random_problem, reconfigure

sys.path.insert(0, str(Path(__file__).parents[1] / "bench"))
from gap_judge import _hull, judge_gaps  # noqa: E402


def planes():
    listed = with_drive(preset("desi_petals", 40), "desi", 0.55)  # outlines, walls, discs
    return {
        "listed speeds": listed,
        "ramp": with_drive(preset("desi", 37), "accelerated"),
        "uncertain": with_drive(preset("sdss_v", 37), "sdss_v"),
    }


@pytest.fixture(scope="module", params=["listed speeds", "ramp", "uncertain"])
def result(request):
    return reconfigure(random_problem(planes()[request.param], seed=3))


def arrays(result, folder):
    result.save(folder, recording=False)
    return (dict(np.load(folder / name)) for name in ("problem.npz", "plan.npz"))


def test_it_finds_the_gap_that_is_certified(result, tmp_path):
    problem, plan = arrays(result, tmp_path)
    found = judge_gaps(problem, plan)
    certificate = certify(result.plane, result.motion, Safety())
    assert certificate.ok and (found.contacts, found.near) == (0, 0)
    assert found.least_mm >= certificate.min_gap_mm
    # the same gap where it is looked for: every pair is resolved below this margin
    wide = judge_gaps(problem, plan, certificate.min_gap_mm + 0.01)
    assert wide.least_mm == pytest.approx(certificate.min_gap_mm, abs=2e-3)
    assert tuple(sorted(wide.pair)) == tuple(sorted(certificate.min_pair))


@pytest.mark.parametrize("seed", [0, 1])
def test_contacts_that_are_planted_are_found(result, tmp_path, seed):
    problem, plan = arrays(result, tmp_path)
    # the order of each robot goes to another one
    order = np.random.default_rng(seed).permutation(result.plane.n)
    motion = result.motion
    first, counts = motion.offsets[:-1].reshape(-1, 2), motion.counts.reshape(-1, 2)
    taken = [
        np.arange(first[row, joint], first[row, joint] + counts[row, joint])
        for row in order
        for joint in range(2)
    ]
    plan["offsets"] = np.concatenate([[0], np.cumsum([len(part) for part in taken])])
    for name in ("duration_s", "velocity_rad_s"):
        plan[name] = plan[name][np.concatenate(taken)]
    found = judge_gaps(problem, plan)
    shuffled = type(motion)(
        motion.start, plan["offsets"], plan["duration_s"], plan["velocity_rad_s"]
    )
    certificate = certify(result.plane, shuffled, Safety(margin_mm=0.05))
    assert found.contacts == (certificate.gap_mm <= 0.0).sum() > 0
    assert found.least_mm <= 0.0


def test_a_contact_of_a_moment_between_two_waits_is_found():
    # one arm sweeps past a disc that it touches for some milliseconds of an hour
    plane = replace(preset("desi", 1), obstacles=np.array([[0.0, 7.0, 0.95]]))
    problem = {
        "center_mm": plane.centers,
        "arm_mm": plane.arms,
        "radius_mm": plane.phi_radius,
        "disc_mm": plane.obstacles + np.array([*plane.centers[0], 0.0]),
    }
    plan = {
        "offsets": np.array([0, 3, 3]),
        "duration_s": np.array([1800.0, 1.0, 1800.0]),
        "velocity_rad_s": np.array([0.0, np.pi, 0.0]),
        "start_rad": np.zeros((1, 2)),
    }
    reach = float(plane.arms[0].sum() + plane.phi_radius[0])
    for gap_mm, contacts in ((0.01, 0), (-0.001, 1)):
        problem["disc_mm"][0, 2] = 7.0 - reach - gap_mm
        found = judge_gaps(problem, plan)
        # a pair that touches is a contact, and not near as well
        assert (found.contacts, found.near) == (contacts, 1 - contacts)
        assert found.least_mm == pytest.approx(gap_mm, abs=5e-4)


def too_close(gap_mm, turns):
    """Two stretched arms on one line, tip to tip; each turns both arms by that much in a second."""
    plane = replace(preset("desi", 2), centers=np.array([[0.0, 0.0], [20.0, 0.0]]))
    start = np.array([[0.0, 0.0], [np.pi, 0.0]])
    wide = float(gaps(plane, [[0, 1]], start)[0])
    plane = replace(plane, centers=np.array([[0.0, 0.0], [20.0 - wide + gap_mm, 0.0]]))
    counts = np.array([0, turns[0] != 0.0, 0, turns[1] != 0.0, 0]).cumsum()
    velocity = np.array([turn for turn in turns if turn != 0.0])
    plan = {
        "offsets": counts,
        "duration_s": np.ones(len(velocity)),
        "velocity_rad_s": velocity,
        "start_rad": start,
    }
    return problem_columns(Problem(plane, start, np.full((2, 2), np.nan))), plan


@pytest.mark.parametrize("gap_mm", [0.02, -0.3])
@pytest.mark.parametrize(
    "turns, leaving", [((0.5, 0.0), 1), ((0.5, 0.5), 0), ((0.0, 0.0), 0), ((0.0, -0.5), 1)]
)
def test_of_a_pair_that_starts_too_close_one_may_leave(gap_mm, turns, leaving):
    found = judge_gaps(*too_close(gap_mm, turns))
    touches = int(gap_mm < 0.0)
    assert (found.near, found.contacts) == (1 - touches, touches)
    assert (found.leaving, found.leaving_contacts) == (leaving * (1 - touches), leaving * touches)
    assert found.resting == int(turns == (0.0, 0.0)) * (1 - touches)
    assert found.nearer_mm <= 1e-3 and found.least_mm == pytest.approx(gap_mm, abs=1e-3)


@pytest.mark.parametrize("turned", [-0.2, 0.2])
def test_a_pair_that_starts_too_close_and_comes_nearer_is_not_leaving(turned):
    problem, plan = too_close(0.02, (turned, 0.0))
    plan["start_rad"] = plan["start_rad"] - np.array([[0.5 * turned, 0.0], [0.0, 0.0]])
    wide = judge_gaps(problem, plan, margin_mm=1.0)
    assert wide.leaving == 0 and wide.near == 1
    assert wide.nearer_mm > 0.01


def test_depths_are_those_of_the_certificate(tmp_path):
    plane = preset("desi_outlines", 37)
    problem = random_problem(plane, seed=1)
    start = np.random.default_rng(2).uniform(*np.moveaxis(plane.limits, -1, 0))
    for a, b in neighbour_pairs(plane)[:60]:
        alone = plane.permuted([a, b])
        gap = float(gaps(alone, [[0, 1]], start[[a, b]])[0])
        columns = problem_columns(
            replace(problem, plane=alone, start=start[[a, b]], targets=problem.targets[[a, b]])
        )
        rest = {
            "offsets": np.zeros(5, dtype=int),
            "duration_s": np.zeros(0),
            "velocity_rad_s": np.zeros(0),
            "start_rad": start[[a, b]],
        }
        found = judge_gaps(columns, rest, margin_mm=20.0)
        assert found.least_mm == pytest.approx(gap, abs=2e-6)


def test_hulls_are_those_of_scipy_also_where_corners_lie_on_edges():
    rng = np.random.default_rng(0)
    square = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]])
    for _ in range(300):
        turn = rng.uniform(0.0, 2.0 * np.pi)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        share = rng.random((12, 1))
        on_edges = share * square[[0, 1, 2] * 4] + (1.0 - share) * square[[1, 2, 3] * 4]
        points = np.unique(np.concatenate([square, on_edges]) @ rotation.T, axis=0)
        hull = np.array(_hull(points))
        x, y = hull.T
        area = 0.5 * abs(x @ np.roll(y, 1) - y @ np.roll(x, 1))
        assert area == pytest.approx(ConvexHull(points).volume, rel=1e-9)
