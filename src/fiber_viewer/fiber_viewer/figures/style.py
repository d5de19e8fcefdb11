# SPDX-License-Identifier: Apache-2.0
"""Colours and names of outcomes and curves, the same in all figures and in the player."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiber_core.outcomes import Outcome
from fiber_core.problem import Problem

__all__ = ["COLORS", "JOINTS", "PLANNED", "STOPPED", "states_of"]

# colours of Okabe and Ito, which differ for every kind of colour blindness
COLORS = {
    "reached": "#009E73",
    "held": "#E69F00",
    "failed": "#D55E00",
    "no target": "#999999",
    "disabled": "#000000",
}
JOINTS = (("theta", "#0072B2"), ("phi", "#D55E00"))
PLANNED = "#7f7f7f"
STOPPED = "#6a4c93"  # between the stop of all robots and the resumed motion


def states_of(problem: Problem, outcome: ArrayLike) -> NDArray[np.str_]:
    """Return the name of the outcome of each robot, as in COLORS, shape (n,).

    Args:
        problem: plane and targets.
        outcome: Outcome of each robot, shape (n,).
    """
    outcome = np.asarray(outcome, dtype=int)
    names = np.array(["reached", "held", "failed"])[outcome]
    names = np.where(problem.asked | (outcome == Outcome.FAILED), names, "no target")
    return np.where(problem.plane.enabled, names, "disabled")
