"""The whole focal plane: at one instant, before and after, and who reached its target."""

import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure

from fiber_core import kinematics
from fiber_core.motion import SegmentMotion
from fiber_core.problem import Problem
from fiber_recording.recording import Recording
from fiber_viewer.figures.style import COLORS, states_of

__all__ = ["before_and_after", "draw_discs", "outcomes", "plane"]


def _draw(axes, problem: Problem, angles, states) -> None:
    plane = problem.plane
    elbow, tip = kinematics.forward(plane, angles)
    colors = [COLORS[s] for s in states]
    first = LineCollection(np.stack([plane.centers, elbow], axis=1), colors="#cccccc", lw=0.5)
    second = LineCollection(np.stack([elbow, tip], axis=1), colors=colors, lw=0.9)
    for name, lines in (("first arms", first), ("second arms", second)):
        lines.set_gid(name)
        axes.add_collection(lines)
    draw_discs(axes, plane.obstacles)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x [mm]")


def draw_discs(axes, discs) -> None:
    """Draw fixed discs x, y, radius [mm], shape (k, 3)."""
    if not len(discs):
        return
    width = 2 * discs[:, 2]
    axes.add_collection(
        EllipseCollection(
            width,
            width,
            np.zeros_like(width),
            units="xy",
            offsets=discs[:, :2],
            offset_transform=axes.transData,
            facecolors="#555555",
        )
    )


def _legend(axes, states) -> None:
    for name, color in COLORS.items():
        count = int((states == name).sum())
        if count:
            axes.plot([], [], "-", color=color, lw=2, label=f"{name} ({count})")
    axes.legend(loc="upper right", framealpha=0.9)


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
    states = states_of(problem, outcome)
    _draw(before, problem, motion.start, states)
    _draw(after, problem, motion.end, states)
    missed = problem.asked & (states != "reached")
    after.plot(*problem.targets[missed].T, "x", color=COLORS["failed"], ms=3, mew=0.6)
    before.set_ylabel("y [mm]")
    before.set_title("before")
    after.set_title(f"after {motion.makespan_s:.2f} s")
    _legend(after, states)
    figure.suptitle(f"{problem.plane.name}: {problem.plane.n} robots")
    return figure


def plane(recording: Recording, t: float = np.inf) -> Figure:
    """Draw the whole plane at a time from the GO on [s], coloured by what became of each robot."""
    figure = Figure(figsize=(9, 9.4), layout="constrained")
    axes = figure.subplots()
    motion = recording.executed
    t = min(t, motion.makespan_s)
    states = states_of(recording.problem, recording.outcome)
    _draw(axes, recording.problem, motion(t), states)
    axes.set_ylabel("y [mm]")
    axes.set_title(f"{recording.problem.plane.name}: {recording.problem.plane.n} robots, {t:.2f} s")
    _legend(axes, states)
    return figure


def outcomes(recording: Recording) -> Figure:
    """Draw a map of who reached its target, was held, or failed; the last two stand out."""
    figure = Figure(figsize=(9, 9.4), layout="constrained")
    axes = figure.subplots()
    centers = recording.problem.plane.centers
    states = states_of(recording.problem, recording.outcome)
    for order, (name, color) in enumerate(COLORS.items()):
        chosen = states == name
        if chosen.any():
            notable = name in ("held", "failed")
            axes.scatter(
                *centers[chosen].T,
                s=28 if notable else 5,
                marker="X" if name == "failed" else "o",
                color=color,
                zorder=2 + order * notable,
                label=f"{name} ({chosen.sum()})",
            )
    draw_discs(axes, recording.problem.plane.obstacles)
    axes.set_aspect("equal")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    axes.legend(loc="upper right", framealpha=0.9)
    report = recording.about["report"]
    axes.set_title(f"{report['reached']} of {report['asked']} robots reached their targets")
    return figure
