"""Colours and names of what can become of a robot, alike in all figures and in the player."""

import numpy as np

from fiber_core.outcomes import Outcome
from fiber_core.problem import Problem

__all__ = ["COLORS", "JOINTS", "PLANNED", "STOPPED", "states_of"]

# Okabe-Ito colours, apart for every kind of colour blindness
COLORS = {
    "reached": "#009E73",
    "held": "#E69F00",
    "failed": "#D55E00",
    "nothing asked": "#999999",
    "disabled": "#000000",
}
JOINTS = (("theta", "#0072B2"), ("phi", "#D55E00"))
PLANNED = "#7f7f7f"
STOPPED = "#6a4c93"  # between a stop of all and going on


def states_of(problem: Problem, outcome) -> np.ndarray:
    """Return the name in COLORS of what became of each robot, shape (n,).

    Args:
        problem: what was asked.
        outcome: Outcome of each robot, shape (n,).
    """
    outcome = np.asarray(outcome, dtype=int)
    names = np.array(["reached", "held", "failed"])[outcome]
    names = np.where(problem.asked | (outcome == Outcome.FAILED), names, "nothing asked")
    return np.where(problem.plane.enabled, names, "disabled")
