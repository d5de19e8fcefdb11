# SPDX-License-Identifier: Apache-2.0
"""Figures of the whole focal plane: at one instant, before and after a plan, and the outcomes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection, PolyCollection
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from fiber_core import kinematics
from fiber_core.array_types import Angles
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SegmentMotion
from fiber_core.problem import Problem
from fiber_recording.recording import Recording
from fiber_viewer.figures.style import COLORS, states_of

__all__ = ["before_and_after", "draw_fixtures", "outcomes", "plane"]


def _draw_arms(axes: Axes, problem: Problem, angles: Angles, states: NDArray[np.str_]) -> None:
    """Draw all arms as lines; the phi arms in the colours of the states."""
    plane = problem.plane
    elbow, tip = kinematics.forward(plane, angles)
    colors = [COLORS[s] for s in states]
    theta_arms = list(np.stack([plane.centers, elbow], axis=1))
    phi_arms = list(np.stack([elbow, tip], axis=1))
    for name, lines in (
        ("theta arms", LineCollection(theta_arms, colors="#cccccc", lw=0.5)),
        ("phi arms", LineCollection(phi_arms, colors=colors, lw=0.9)),
    ):
        lines.set_gid(name)
        axes.add_collection(lines)
    draw_fixtures(axes, plane)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x [mm]")


def draw_fixtures(axes: Axes, plane: FocalPlane) -> None:
    """Draw the fixed discs and walls of a plane.

    Args:
        axes: where to draw.
        plane: the focal plane.
    """
    if len(plane.walls):
        walls = PolyCollection(
            list(plane.walls), facecolors="#999999", edgecolors="#555555", lw=0.6
        )
        axes.add_collection(walls)
    discs = plane.obstacles
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


def _draw_legend(axes: Axes, states: NDArray[np.str_]) -> None:
    for name, color in COLORS.items():
        count = int((states == name).sum())
        if count:
            axes.plot([], [], "-", color=color, lw=2, label=f"{name} ({count})")
    axes.legend(loc="upper right", framealpha=0.9)


def before_and_after(problem: Problem, motion: SegmentMotion, outcome: ArrayLike) -> Figure:
    """Draw the plane before and after a motion, coloured by the outcome of each robot.

    Args:
        problem: plane and targets.
        motion: the motion.
        outcome: Outcome of each robot, shape (n,).

    Returns:
        A figure with two panels; crosses mark the targets that were not reached.
    """
    figure = Figure(figsize=(18, 9.6), layout="constrained")
    before, after = figure.subplots(1, 2, sharex=True, sharey=True)
    states = states_of(problem, outcome)
    _draw_arms(before, problem, motion.start, states)
    _draw_arms(after, problem, motion.end, states)
    missed = problem.asked & (states != "reached")
    after.plot(*problem.targets[missed].T, "x", color=COLORS["failed"], ms=3, mew=0.6)
    before.set_ylabel("y [mm]")
    before.set_title("before")
    after.set_title(f"after {motion.makespan_s:.2f} s")
    _draw_legend(after, states)
    figure.suptitle(f"{problem.plane.name}: {problem.plane.n} robots")
    return figure


def plane(recording: Recording, t: float = np.inf) -> Figure:
    """Draw the whole plane at one instant, coloured by the outcome of each robot.

    Args:
        recording: the recording.
        t: time from the begin of the motion [s]; by default its end.
    """
    figure = Figure(figsize=(9, 9.4), layout="constrained")
    axes = figure.subplots()
    motion = recording.executed
    t = min(t, motion.makespan_s)
    states = states_of(recording.problem, recording.outcome)
    _draw_arms(axes, recording.problem, motion(t), states)
    axes.set_ylabel("y [mm]")
    axes.set_title(f"{recording.problem.plane.name}: {recording.problem.plane.n} robots, {t:.2f} s")
    _draw_legend(axes, states)
    return figure


def outcomes(recording: Recording) -> Figure:
    """Draw a map of the outcomes of all robots; held and failed robots have larger marks.

    Args:
        recording: the recording.
    """
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
    draw_fixtures(axes, recording.problem.plane)
    axes.set_aspect("equal")
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    axes.legend(loc="upper right", framealpha=0.9)
    report = recording.about["report"]
    axes.set_title(f"{report['reached']} of {report['asked']} robots reached their targets")
    return figure
