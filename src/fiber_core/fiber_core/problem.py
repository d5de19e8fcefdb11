# SPDX-License-Identifier: Apache-2.0
"""Problems and plans, and the exchange files that hold them."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_core import bounds
from fiber_core.array_types import Angles, Bools, Codes, Floats, Mask, Points
from fiber_core.drive import CurveMotion, Drive, ListedSpeeds, carried_out
from fiber_core.errors import FiberError, LayoutError, MotionError
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Outcome
from fiber_core.validation import frozen_array

__all__ = [
    "FilePath",
    "Problem",
    "load_plan",
    "load_problem",
    "problem_columns",
    "problem_of",
    "save_plan",
    "save_problem",
]

FilePath: TypeAlias = str | PathLike[str]

_NEEDED = "id center_mm arm_mm radius_mm start_rad target_mm enabled speed_rad_s limits_rad".split()


@dataclass(frozen=True, eq=False)
class Problem:
    """One reconfiguration: a plane, the present joint angles and the targets.

    Args:
        plane: the focal plane.
        start: present joint angles [rad], shape (n, 2).
        targets: target of each fibre [mm], shape (n, 2), nan = no target.

    Raises:
        LayoutError: a shape does not fit the plane, a start angle is not finite or outside
            the bounds, or a target is neither a point nor nan.
    """

    plane: FocalPlane
    start: Angles
    targets: Points

    def __post_init__(self):
        for name in ("start", "targets"):
            value = frozen_array(
                getattr(self, name), np.float64, (self.plane.n, 2), name, LayoutError
            )
            object.__setattr__(self, name, value)
        started, asked = np.isfinite(self.start), np.isfinite(self.targets)
        no_target = np.isnan(self.targets).all(axis=1)
        self._check("start", self.start, np.all(started, axis=1))
        far = np.abs(self.start) > bounds.MAX_ANGLE_RAD
        if far.any():
            at = int(np.argmax(far.any(axis=1)))
            raise LayoutError(
                f"robot {self.plane.ids[at]}: start must be {-bounds.MAX_ANGLE_RAD:.6g} to "
                f"{bounds.MAX_ANGLE_RAD:.6g} rad, got {self.start[at].tolist()}"
            )
        self._check("target", self.targets, np.all(asked, axis=1) | no_target)

    def _check(self, name: str, values: Floats, good: Bools) -> None:
        if not good.all():
            at = int(np.argmin(good))
            raise LayoutError(
                f"robot {self.plane.ids[at]}: {name} {values[at].tolist()} is not finite"
            )

    @property
    def asked(self) -> Mask:
        """Robots with a target, shape (n,)."""
        return np.all(np.isfinite(self.targets), axis=1)


def problem_columns(problem: Problem) -> dict[str, NDArray[Any]]:
    """Return a problem as named arrays with units in the names.

    A problem.npz holds these arrays, and a recording holds them among others.

    Args:
        problem: the problem.
    """
    plane = problem.plane
    drive = {} if plane.drive.is_plain else _drive_columns(plane.drive)
    columns: dict[str, NDArray[Any]] = drive | {
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
        "wall_mm": plane.walls,
        "phi_outline_mm": plane.phi_vertices,
        "theta_outline_mm": plane.theta_vertices,
        "theta_radius_mm": plane.theta_radius,
        "bus": plane.bus,
        "address": plane.address,
        "spacing_mm": np.array(plane.spacing_mm),
        "envelope_mm": np.array(plane.envelope_mm),
        "name": np.array(plane.name),
    }
    if plane.sector.any():
        columns["sector"] = plane.sector
    if plane.fibres.shape[1]:
        columns |= {
            "fibre_mm": plane.fibres,
            "fibre_names": np.array(plane.fibre_names),
            "fibre": plane.fibre,
        }
    if plane.coupling.shape[1]:
        columns |= {
            "coupling": plane.coupling,
            "motor_speed_rad_s": plane.motor_speeds,
            "motor_limits_rad": plane.motor_limits,
        }
    return columns


def _drive_columns(drive: Drive) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {
        "drive": np.array(drive.name),
        "ramp_s": np.array(drive.ramp_s),
        "acceleration_rad_s2": drive.acceleration_rad_s2,
        "uncertainty_rad": drive.uncertainty_rad,
        "lost_motion_rad": drive.lost_motion_rad,
        "motor_scale": drive.scale,
        "motors_on": np.array(drive.motors_on),
    }
    if drive.supply is not None:
        columns["supply"] = drive.supply
    if drive.listed is not None:
        columns["listed_speeds"] = drive.listed.numbers
    return columns


def _drive_of(data: Mapping[str, NDArray[Any]], n: int) -> Drive:
    # the drive in named arrays, an ideal one where they hold none
    def number(name: str, otherwise: float) -> float:
        value = data.get(name, otherwise)
        return float(frozen_array(value, np.float64, (), name, LayoutError))

    listed = data.get("listed_speeds")
    return Drive(
        n,
        number("ramp_s", 0.0),
        data.get("acceleration_rad_s2", np.inf),
        data.get("uncertainty_rad", 0.0),
        str(data.get("drive", "ideal")),
        None if listed is None else ListedSpeeds.of_numbers(listed),
        data.get("motor_scale", 1.0),
        data.get("lost_motion_rad", 0.0),
        data.get("supply"),
        number("motors_on", 1.0),
        data["id"],
    )


def save_problem(path: FilePath, problem: Problem) -> None:
    """Write a problem as a .npz file with units in the names of its fields.

    Args:
        path: the .npz file.
        problem: the problem.
    """
    # a dictionary of Any, as numpy's stubs count the option allow_pickle among the arrays
    columns: dict[str, Any] = dict(problem_columns(problem))
    np.savez_compressed(path, **columns)


def load_problem(path: FilePath, content: bytes | None = None) -> Problem:
    """Read a problem file, of this or any other program.

    Only the fields of the exchange format must be there. Without outlines, the phi arm is a
    capsule from elbow to tip.

    Args:
        path: the .npz file.
        content: what the file holds, if it was read and unpacked already.

    Raises:
        LayoutError: the file is not a problem file, or a field is missing or does not fit;
            names the file and the field.
    """
    return problem_of(_read(path, _NEEDED, LayoutError, content), str(path))


def problem_of(data: Mapping[str, NDArray[Any]], name: str) -> Problem:
    """Return the problem in named arrays.

    Args:
        data: named arrays, as from problem_columns; outlines, discs, walls, fibres, coupling,
            buses, spacing, envelope, name and the drive may be missing.
        name: name of the plane if the arrays hold none.

    Raises:
        LayoutError: a field does not fit; names it.
    """
    missing = [name for name in _NEEDED if name not in data]
    if missing:
        raise LayoutError(f"{name} has no field {', '.join(missing)}")
    n = np.size(data["id"])
    arms = frozen_array(data["arm_mm"], np.float64, (n, 2), "arm_mm", LayoutError)
    radius = frozen_array(data["radius_mm"], np.float64, (n,), "radius_mm", LayoutError)
    spacing = data.get("spacing_mm", np.array(0.0))
    apart = spacing if "spacing_mm" in data else np.array(4 * radius.max(initial=0.0))
    envelope = data.get("envelope_mm", apart)
    elbow_to_tip = np.zeros((n, 2, 2))
    elbow_to_tip[:, 1, 0] = arms[:, 1]
    plane = FocalPlane(
        ids=data["id"],
        centers=data["center_mm"],
        arms=arms,
        limits=data["limits_rad"],
        speeds=data["speed_rad_s"],
        phi_vertices=data.get("phi_outline_mm", elbow_to_tip),
        phi_radius=radius,
        theta_vertices=data.get("theta_outline_mm", np.zeros((n, 0, 2))),
        theta_radius=data.get("theta_radius_mm", np.zeros(n)),
        enabled=data["enabled"],
        obstacles=data.get("disc_mm", np.zeros((0, 3))),
        bus=data.get("bus"),
        address=data.get("address"),
        sector=data.get("sector"),
        spacing_mm=float(frozen_array(spacing, np.float64, (), "spacing_mm", LayoutError)),
        envelope_mm=float(frozen_array(envelope, np.float64, (), "envelope_mm", LayoutError)),
        name=str(data.get("name", name)),
        walls=data.get("wall_mm"),
        fibres=data.get("fibre_mm"),
        fibre_names=tuple(data["fibre_names"].tolist()) if "fibre_names" in data else None,
        fibre=data.get("fibre"),
        drive=_drive_of(data, n),
        coupling=data.get("coupling"),
        motor_speeds=data.get("motor_speed_rad_s"),
        motor_limits=data.get("motor_limits_rad"),
    )
    return Problem(plane, data["start_rad"], data["target_mm"])


def save_plan(
    path: FilePath,
    motion: SegmentMotion,
    outcome: ArrayLike,
    reason: ArrayLike,
    drive: Drive | None = None,
) -> None:
    """Write a plan: the motion decoded from the bytes, and the outcome of each robot.

    With ramps, the fields ``curve_*`` hold the true curves: for each change of the law of each
    joint its time, and angle, velocity and acceleration from then on. A joint rests from the last
    change on, whose velocity and acceleration are zero.

    Args:
        path: the .npz file.
        motion: the motion as sent.
        outcome: Outcome of each robot, shape (n,).
        reason: Reason of each robot, shape (n,).
        drive: how the motors carry out orders; by default ideally.
    """
    curves: dict[str, Any] = {}
    if drive is not None and drive.has_curves:
        curves = _curve_columns(carried_out(drive, motion))
    np.savez_compressed(
        path,
        offsets=motion.offsets,
        duration_s=motion.duration_s,
        velocity_rad_s=motion.velocity_rad_s,
        start_rad=motion.start,
        outcome=np.asarray(outcome, dtype=np.int64),
        outcome_names=np.array([o.name.lower() for o in Outcome]),
        reason=np.asarray(reason, dtype=np.int64),
        **curves,
    )


def _curve_columns(true_motion: SegmentMotion | CurveMotion) -> dict[str, Any]:
    assert isinstance(true_motion, CurveMotion)  # there is a ramp
    knots = true_motion.parts.knots
    inner = np.ones(knots.total, dtype=bool)
    inner[knots.offsets[1:] - 1] = False  # the last knot of each profile
    columns = {
        "curve_offsets": knots.offsets,
        "curve_time_s": true_motion.parts.running(true_motion.duration_s),
    }
    for name, values, last in (
        ("curve_angle_rad", true_motion.angle_rad, true_motion.end.ravel()),
        ("curve_velocity_rad_s", true_motion.velocity_rad_s, 0.0),
        ("curve_acceleration_rad_s2", true_motion.acceleration_rad_s2, 0.0),
    ):
        columns[name] = np.empty(knots.total)
        columns[name][inner], columns[name][~inner] = values, last
    return columns


def load_plan(path: FilePath, start: ArrayLike) -> tuple[SegmentMotion, Codes]:
    """Read a plan file.

    Args:
        path: the .npz file.
        start: joint angles at the start of the plan [rad], shape (n, 2).

    Returns:
        The motion, and the Outcome of each robot, shape (n,).

    Raises:
        MotionError: the file is not a plan file, or a field is missing or does not fit; names
            the file and the field.
    """
    data = _read(path, ["offsets", "duration_s", "velocity_rad_s", "outcome"], MotionError)
    motion = SegmentMotion(
        np.asarray(start), data["offsets"], data["duration_s"], data["velocity_rad_s"]
    )
    return motion, frozen_array(data["outcome"], np.int64, (motion.n,), "outcome", MotionError)


def _read(
    path: FilePath, needed: Sequence[str], error: type[FiberError], content: bytes | None = None
) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path if content is None else io.BytesIO(content)) as file:
            data = dict(file)
    except Exception as problem:  # zipfile, zlib and numpy raise errors of a dozen types
        text = str(problem) or type(problem).__name__
        raise error(f"{path} is not a problem or plan file: {text}") from None
    missing = [name for name in needed if name not in data]
    if missing:
        raise error(f"{path} has no field {', '.join(missing)}")
    return data
