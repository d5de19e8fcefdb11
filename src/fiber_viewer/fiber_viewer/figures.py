"""Figures of a reconfiguration for the night log."""

import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure

from fiber_core import kinematics
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import Outcome
from fiber_core.problem import Problem

__all__ = ["before_and_after"]

# Okabe-Ito colours, apart for every kind of colour blindness
_COLORS = {
    "reached": "#0072B2",
    "held": "#E69F00",
    "failed": "#D55E00",
    "nothing asked": "#999999",
    "disabled": "#000000",
}


def _states(problem: Problem, outcome) -> np.ndarray:
    names = np.array(["reached", "held", "failed"])[np.asarray(outcome, dtype=int)]
    names = np.where(problem.asked | (outcome == Outcome.FAILED), names, "nothing asked")
    return np.where(problem.plane.enabled, names, "disabled")


def _draw(axes, problem: Problem, angles, states) -> None:
    plane = problem.plane
    elbow, tip = kinematics.forward(plane, angles)
    colors = [_COLORS[s] for s in states]
    first = LineCollection(np.stack([plane.centers, elbow], axis=1), colors="#cccccc", lw=0.5)
    second = LineCollection(np.stack([elbow, tip], axis=1), colors=colors, lw=0.9)
    for name, lines in (("first arms", first), ("second arms", second)):
        lines.set_gid(name)
        axes.add_collection(lines)
    if len(plane.obstacles):
        width = 2 * plane.obstacles[:, 2]
        discs = EllipseCollection(
            width,
            width,
            np.zeros_like(width),
            units="xy",
            offsets=plane.obstacles[:, :2],
            offset_transform=axes.transData,
            facecolors="#555555",
        )
        axes.add_collection(discs)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x [mm]")


def before_and_after(problem: Problem, motion: SegmentMotion, outcome) -> Figure:
    """Draw the plane before and after a motion, coloured by what became of each robot.

    Args:
        problem: what was asked.
        motion: the motion as sent.
        outcome: Outcome of each robot, shape (n,).

    Returns:
        A figure of two panels; targets that were not reached are crossed.
    """
    figure = Figure(figsize=(18, 9.6), layout="constrained")
    before, after = figure.subplots(1, 2, sharex=True, sharey=True)
    states = _states(problem, np.asarray(outcome))
    _draw(before, problem, motion.start, states)
    _draw(after, problem, motion.end, states)
    missed = problem.asked & (states != "reached")
    after.plot(*problem.targets[missed].T, "x", color=_COLORS["failed"], ms=3, mew=0.6)
    before.set_ylabel("y [mm]")
    before.set_title("before")
    after.set_title(f"after {motion.makespan_s:.2f} s")
    for name, color in _COLORS.items():
        count = int((states == name).sum())
        if count:
            after.plot([], [], "-", color=color, lw=2, label=f"{name} ({count})")
    after.legend(loc="upper right", framealpha=0.9)
    figure.suptitle(f"{problem.plane.name}: {problem.plane.n} robots")
    return figure
