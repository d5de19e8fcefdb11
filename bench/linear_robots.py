# SPDX-License-Identifier: Apache-2.0
"""Blind errors of robots with a joint that turns less than ordered, beside the others.

A field is planned once, and its motion is that of many simulated planes: what one draw of the
errors gives for some 460 robots differs by 2 to 3 um rms from that of the next.
"""

from typing import Any

import numpy as np
from closed_loop import DRIVE

from fiber_bus_bridge.simulation import MechanicalErrors, Mechanics, draw_mechanics
from fiber_bus_bridge.simulation.true_arms import arms_at, arms_motion, true_angles
from fiber_core import kinematics
from fiber_core.array_types import Floats
from fiber_core.fields import random_field
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason
from fiber_core.problem import Problem
from fiber_metrology.camera import CameraConfig, SimulatedCamera, fiducial_places
from fiber_positioners import closed_loop
from fiber_positioners.simulated_run import SimulatedRun

__all__ = ["linear_robots", "pooled_rms"]

_LINEAR = 0.9  # a joint that turns by less than this share of what is ordered
_DRAWS = 20
_PARTS = {
    "scale": ("scale",),
    "speed": ("speed_noise",),
    "non-linearity": ("wave_rad", "phase_rad"),
    "backlash": ("backlash_rad", "slack_rad"),
    "orders": (),
}


def linear_robots(plane: FocalPlane, seed: int) -> dict[str, Any]:
    """Return the figures of one field.

    Args:
        plane: the plane, with the drive of its motors.
        seed: of field, errors and camera.
    """
    rng = np.random.default_rng(seed)
    problem = random_field(plane, rng, 0.5).problem
    mechanics = draw_mechanics(plane.n, MechanicalErrors(**DRIVE), rng)
    radius_mm = float(np.hypot(*plane.centers.T).max() + plane.arms.sum(axis=1).max())
    camera = SimulatedCamera(radius_mm, CameraConfig(), rng)
    loop = closed_loop(
        problem, mechanics, camera, fiducial_places(plane), np.ones(plane.n, dtype=np.bool_),
        corrections=0, seed=seed,
    )  # fmt: skip
    move = loop.moves[0]
    asked, moved = problem.asked, move.orders.reason == Reason.OK
    scaled = (np.abs(plane.drive.scale) < _LINEAR).any(axis=(1, 2)) & plane.enabled
    errors, parts = [1e3 * loop.errors_mm(0)], []
    for draw in range(_DRAWS):
        if draw:
            mechanics = draw_mechanics(plane.n, MechanicalErrors(**DRIVE), rng)
            errors.append(_error_um(problem, move.run, mechanics))
        parts.append([_error_um(problem, move.run, _only(mechanics, of)) for of in _PARTS.values()])
    error_um, linear = np.stack(errors), scaled & asked & moved
    of_draws = np.sqrt(np.mean(error_um[:, linear] ** 2, axis=1))
    of_parts = np.sqrt(np.mean(np.stack(parts)[:, :, linear] ** 2, axis=(0, 2)))
    return {
        "asked": int(asked.sum()),
        "reached": int((asked & moved).sum()),
        "linear": int(scaled.sum()),
        "linear_asked": int((scaled & asked).sum()),
        "linear_ordered": int(linear.sum()),
        "draws": _DRAWS,
        "linear_rms_um": pooled_rms(of_draws),
        "of_one_draw_um": [float(of_draws.min()), float(of_draws.max())],
        "parts_um": dict(zip(_PARTS, of_parts.tolist())),
        "others_rms_um": pooled_rms(error_um[:, ~scaled & asked & moved]),
        "contacts": int(move.touches.unsafe.sum()),
    }


def pooled_rms(values: np.ndarray) -> float:
    """Return the rms of values, or of the rms of equally many values."""
    return float(np.sqrt(np.mean(values**2)))


def _only(mechanics: Mechanics, names: tuple[str, ...]) -> Mechanics:
    kept = {name: getattr(mechanics, name) for name in names}
    return Mechanics.ideal(mechanics.n).with_(**kept, seed=mechanics.seed)


def _error_um(problem: Problem, run: SimulatedRun, mechanics: Mechanics) -> Floats:
    # distance of each true fibre from its target after the motion
    assert run.counters is not None  # it was observed
    _, state = arms_motion(mechanics, arms_at(mechanics, problem.start), *run.counters)
    tips = kinematics.forward(problem.plane, true_angles(mechanics, state))[1]
    return np.asarray(1e3 * np.hypot(*(tips - problem.targets).T))
