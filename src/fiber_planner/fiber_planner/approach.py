# SPDX-License-Identifier: Apache-2.0
"""Limits of the ends of motors that make an approach."""

from dataclasses import replace

import numpy as np

from fiber_core.problem import Problem

__all__ = ["inside_approaches"]


def inside_approaches(problem: Problem, spare_rad: float = 0.0) -> Problem:
    """Return the problem with limits inside which the approach of no joint leads to a stop.

    Args:
        problem: the plane, the present joint angles and the targets.
        spare_rad: by how much more the limits are narrowed where an approach begins [rad].
    """
    plane, listed = problem.plane, problem.plane.drive.listed
    if listed is None or not listed.approach_rad.any():
        return problem
    limits = plane.limits.copy()
    needs = np.where(listed.approach_rad > 0.0, listed.approach_rad + spare_rad, 0.0)
    low = np.where(listed.approach_sign > 0.0, needs, 0.0)
    high = np.where(listed.approach_sign > 0.0, 0.0, needs)
    limits[:, :, 0] = np.minimum(limits[:, :, 0] + low, limits.mean(axis=2))
    limits[:, :, 1] = np.maximum(limits[:, :, 1] - high, limits[:, :, 0])
    return replace(problem, plane=replace(plane, limits=limits))
