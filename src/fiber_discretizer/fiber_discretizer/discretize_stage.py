# SPDX-License-Identifier: Apache-2.0
"""The discretization stage of a plan, as the node and the pipeline without ROS run it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Codes, Mask
from fiber_core.clearance import Safety
from fiber_core.errors import MotionError
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import first_reason, holds
from fiber_core.wire_units import WireUnits
from fiber_discretizer.discretize import Discretization, discretize
from fiber_discretizer.options import DiscretizeOptions, ProgressCallback

__all__ = ["DiscretizeStageResult", "discretize_trajectory"]


@dataclass(frozen=True, eq=False)
class DiscretizeStageResult:
    """The result of the discretization stage.

    Args:
        discretization: the orders, with their certificate.
        reason: Reason of the first stage that held each robot, else OK or NO_TARGET,
            shape (n,).
    """

    discretization: Discretization
    reason: Codes

    @property
    def held(self) -> Mask:
        """Robots that a stage holds, shape (n,)."""
        return holds(self.reason)


def discretize_trajectory(
    plane: FocalPlane,
    present: ArrayLike,
    ids: ArrayLike,
    trajectory: SampledMotion,
    units: WireUnits,
    safety: Safety,
    *,
    options: DiscretizeOptions | None = None,
    progress: ProgressCallback | None = None,
    velocities: ArrayLike | None = None,
    earlier: ArrayLike | None = None,
) -> DiscretizeStageResult:
    """Discretize a trajectory of some or all robots of a plane, the others at rest.

    Args:
        plane: the focal plane.
        present: present joint angles of all its robots [rad], shape (n, 2).
        ids: robots of the trajectory, shape (k,).
        trajectory: joint profiles of these k robots.
        units: size of tick and quantum, and the widths of the fields.
        safety: gap asked for and timing errors to survive.
        options: options of the discretizer; by default as DiscretizeOptions says.
        progress: called with the fraction of the work that is done, 0..1, and a short text.
        velocities: joint velocities at the points of the trajectory [rad/s], shape
            (k, 2, t), or None; only compared with the limits.
        earlier: Reason of each robot from the stages before, shape (n,); none by default.

    Raises:
        MotionError: a robot of the trajectory is not in the plane, or the trajectory does not
            fit the plane.
    """
    present = np.asarray(present, dtype=float)
    motion, velocities = _of_whole_plane(plane, present, ids, trajectory, velocities)
    counts = units.to_counts(present)
    done = discretize(plane, motion, units, safety, counts, options, progress, velocities)
    stages = (done.reason,) if earlier is None else (earlier, done.reason)
    return DiscretizeStageResult(done, first_reason(*stages))


def _of_whole_plane(
    plane: FocalPlane,
    present: ArrayLike,
    ids: ArrayLike,
    trajectory: SampledMotion,
    velocities: ArrayLike | None,
) -> tuple[SampledMotion, ArrayLike | None]:
    # the trajectory, and its velocities if it has any, with all other robots at rest
    ids = np.asarray(ids)
    rows = plane.index_of(ids)
    if (rows < 0).any():
        raise MotionError(f"robot {ids[rows < 0][0]} of the trajectory is not in the layout")
    if np.array_equal(rows, np.arange(plane.n)):
        return trajectory, velocities
    angles = np.repeat(np.asarray(present)[:, :, None], len(trajectory.time_s), axis=2)
    angles[rows] = trajectory.angles
    if velocities is not None:
        of_all = np.zeros_like(angles)
        of_all[rows] = velocities
        velocities = of_all
    return SampledMotion(trajectory.time_s, angles), velocities
