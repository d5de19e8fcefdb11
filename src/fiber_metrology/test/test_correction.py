# SPDX-License-Identifier: Apache-2.0
"""Corrections start at measured angles, with outlines that hold the true arms."""

import numpy as np
import pytest
from metrology_scene import N

from fiber_core import kinematics
from fiber_core.arm_bounds import arms_within, grown
from fiber_core.clearance import levers_of
from fiber_core.presets import preset
from fiber_metrology import MetrologyError, correction_problem, follows


def test_the_problem_starts_at_measured_angles_and_leaves_what_does_not_follow(scene):
    scene.true[:2] = scene.before[:2]  # they did not move
    lit = np.arange(N) != 7
    image = scene.measure(scene.expose(lit))
    targets = kinematics.forward(scene.plane, scene.counters)[1]
    targets[3] = np.nan
    off_mm = scene.rng.uniform(0.0, 0.1, (N, 2))
    problem = correction_problem(image, targets, off_mm)
    np.testing.assert_array_equal(problem.start, image.angles)
    wider = [problem.plane.theta_radius - scene.plane.theta_radius,
             problem.plane.phi_radius - scene.plane.phi_radius]  # fmt: skip
    np.testing.assert_allclose(np.stack(wider, axis=1), off_mm)
    left = [0, 1, 7]
    assert not problem.plane.enabled[left].any() and not problem.asked[[*left, 3]].any()
    assert problem.plane.enabled.sum() == N - 3 and problem.asked.sum() == N - 4
    close = correction_problem(image, targets, off_mm, tolerance_um=60.0)
    off = np.hypot(*(image.places - targets).T)
    np.testing.assert_array_equal(close.asked, follows(image) & (off > 0.06))
    with pytest.raises(MetrologyError, match="targets has shape"):
        correction_problem(image, targets[1:], off_mm)
    with pytest.raises(MetrologyError, match="outlines_off_mm has shape"):
        correction_problem(image, targets, off_mm[1:])


@pytest.mark.parametrize("name", ["desi_outlines", "sdss_v"])
@pytest.mark.parametrize("measured", [True, False])
def test_grown_outlines_hold_the_true_arms_at_every_pose_of_the_motion(name, measured):
    plane, rng = preset(name, 300), np.random.default_rng(6)
    low, high = np.moveaxis(plane.limits, -1, 0)
    angles, wide = rng.uniform(low, high), rng.uniform(0, 0.02, (plane.n, 2))
    error = wide * rng.choice([-1.0, 1.0], wide.shape) * rng.choice([1.0, 0.3], wide.shape)
    tip_mm = np.full(plane.n, np.nan)
    if measured:
        ends = [kinematics.forward(plane, a)[1] for a in (angles, angles + error)]
        tip_mm = np.hypot(*(ends[1] - ends[0]).T)
    theta_mm, phi_mm = arms_within(plane, wide, tip_mm)
    for _ in range(20):  # wherever the motion takes the robot, its errors stay the same
        pose = rng.uniform(low, high)
        for vertices, bound in ((plane.phi_vertices, phi_mm), (plane.theta_vertices, theta_mm)):
            points = [_placed(plane, a, vertices) for a in (pose, pose + error)]
            off = np.linalg.norm(points[1] - points[0], axis=-1).max(axis=1, initial=0.0)
            assert (off <= bound + 1e-9).all()
    box = (wide * levers_of(plane)).sum(axis=1)
    assert measured is False or phi_mm.mean() < 1.6 * box.mean()
    wider = grown(plane, wide, tip_mm)
    np.testing.assert_allclose(wider.phi_radius - plane.phi_radius, phi_mm)
    np.testing.assert_array_equal(wider.centers, plane.centers)


def _placed(plane, angles, vertices):
    """The vertices of the phi or the theta outline in the focal plane."""
    elbow, _ = kinematics.forward(plane, angles)
    phi = vertices is plane.phi_vertices
    turn = angles.sum(axis=1) if phi else angles[:, 0]
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    x, y = np.moveaxis(vertices, -1, 0)
    base = elbow if phi else plane.centers
    return base[:, None] + np.stack([c * x - s * y, s * x + c * y], axis=-1)
