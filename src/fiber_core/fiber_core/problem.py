"""The exchange files: a reconfiguration problem, and the plan that answers it."""

import zipfile
from dataclasses import dataclass

import numpy as np

from fiber_core.errors import LayoutError, MotionError
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Outcome
from fiber_core.validation import frozen_array

__all__ = [
    "Problem",
    "load_plan",
    "load_problem",
    "problem_columns",
    "problem_of",
    "save_plan",
    "save_problem",
]

_NEEDED = "id center_mm arm_mm radius_mm start_rad target_mm enabled speed_rad_s limits_rad".split()


@dataclass(frozen=True, eq=False)
class Problem:
    """One reconfiguration: a plane, where its robots are, where their fibres should go.

    Args:
        plane: the focal plane.
        start: joint angles now [rad], shape (n, 2).
        targets: where each fibre should go [mm], shape (n, 2), nan = nothing asked.

    Raises:
        LayoutError: a shape does not fit the plane, a start angle is not finite, or a
            target is neither a point nor nan.
    """

    plane: FocalPlane
    start: np.ndarray
    targets: np.ndarray

    def __post_init__(self):
        for name in ("start", "targets"):
            value = frozen_array(
                getattr(self, name), np.float64, (self.plane.n, 2), name, LayoutError
            )
            object.__setattr__(self, name, value)
        nothing = np.isnan(self.targets).all(axis=1)
        for name, good in {
            "start": np.isfinite(self.start).all(axis=1),
            "target": np.isfinite(self.targets).all(axis=1) | nothing,
        }.items():
            if not good.all():
                at = int(np.argmin(good))
                value = (self.start if name == "start" else self.targets)[at].tolist()
                raise LayoutError(f"robot {self.plane.ids[at]}: {name} {value} is not finite")

    @property
    def asked(self) -> np.ndarray:
        """Robots with a target, shape (n,)."""
        return np.isfinite(self.targets).all(axis=1)


def problem_columns(problem: Problem) -> dict[str, np.ndarray]:
    """Return a problem as named arrays, with units in the names; outlines join the plain capsule.

    The dictionary is what a problem.npz holds, and part of what a recording holds.
    """
    plane = problem.plane
    return {
        "id": plane.ids,
        "center_mm": plane.centers,
        "arm_mm": plane.arms,
        "radius_mm": plane.phi_radius,
        "start_rad": problem.start,
        "target_mm": problem.targets,
        "enabled": plane.enabled,
        "speed_rad_s": plane.speeds,
        "limits_rad": plane.limits,
        "disc_mm": plane.obstacles,
        "phi_outline_mm": plane.phi_vertices,
        "theta_outline_mm": plane.theta_vertices,
        "theta_radius_mm": plane.theta_radius,
        "bus": plane.bus,
        "address": plane.address,
        "spacing_mm": np.array(plane.spacing_mm),
        "name": np.array(plane.name),
    }


def save_problem(path, problem: Problem) -> None:
    """Write a problem as .npz with units in the names; outlines are added to the plain capsule."""
    np.savez_compressed(path, **problem_columns(problem))


def load_problem(path) -> Problem:
    """Read a problem written by anybody: without outlines the phi arm is a capsule.

    Raises:
        LayoutError: the file is not one, a field is missing or does not fit; names it.
    """
    return problem_of(_read(path, _NEEDED, LayoutError), str(path))


def problem_of(data, name: str) -> Problem:
    """Return the problem in named arrays.

    Args:
        data: named arrays, at least those every problem has.
        name: what to call a plane that does not tell its name.

    Raises:
        LayoutError: a field does not fit; names it.
    """
    n = np.size(data["id"])
    arms = frozen_array(data["arm_mm"], np.float64, (n, 2), "arm_mm", LayoutError)
    elbow_to_tip = np.zeros((n, 2, 2))
    elbow_to_tip[:, 1, 0] = arms[:, 1]
    plane = FocalPlane(
        ids=data["id"],
        centers=data["center_mm"],
        arms=arms,
        limits=data["limits_rad"],
        speeds=data["speed_rad_s"],
        phi_vertices=data.get("phi_outline_mm", elbow_to_tip),
        phi_radius=data["radius_mm"],
        theta_vertices=data.get("theta_outline_mm", np.zeros((n, 0, 2))),
        theta_radius=data.get("theta_radius_mm", np.zeros(n)),
        enabled=data["enabled"],
        obstacles=data.get("disc_mm", np.zeros((0, 3))),
        bus=data.get("bus"),
        address=data.get("address"),
        spacing_mm=float(data.get("spacing_mm", 4 * data["radius_mm"].max(initial=0.0))),
        name=str(data.get("name", name)),
    )
    return Problem(plane, data["start_rad"], data["target_mm"])


def save_plan(path, motion: SegmentMotion, outcome, reason) -> None:
    """Write the motion decoded from the bytes, and what became of each robot.

    Args:
        path: the .npz file.
        motion: the motion as sent.
        outcome: Outcome of each robot, shape (n,).
        reason: Reason of each robot, shape (n,).
    """
    np.savez_compressed(
        path,
        offsets=motion.offsets,
        duration_s=motion.duration_s,
        velocity_rad_s=motion.velocity_rad_s,
        start_rad=motion.start,
        outcome=np.asarray(outcome, dtype=np.int64),
        outcome_names=np.array([o.name.lower() for o in Outcome]),
        reason=np.asarray(reason, dtype=np.int64),
    )


def load_plan(path, start) -> tuple[SegmentMotion, np.ndarray]:
    """Read a plan for robots at `start` [rad], shape (n, 2): the motion and the outcomes (n,).

    Raises:
        MotionError: the file is not one, a field is missing or does not fit; names it.
    """
    data = _read(path, ["offsets", "duration_s", "velocity_rad_s", "outcome"], MotionError)
    motion = SegmentMotion(start, data["offsets"], data["duration_s"], data["velocity_rad_s"])
    return motion, frozen_array(data["outcome"], np.int64, (motion.n,), "outcome", MotionError)


def _read(path, needed, error):
    try:
        with np.load(path) as file:
            data = dict(file)
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as reason:
        raise error(f"{path} is no exchange file: {reason}") from None
    missing = [name for name in needed if name not in data]
    if missing:
        raise error(f"{path} has no field {', '.join(missing)}")
    return data
