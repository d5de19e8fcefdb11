# SPDX-License-Identifier: Apache-2.0
"""Robots that come near each other, at six moments, as figure 5 of Makarem et al. (2014b)."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy.typing import ArrayLike

from fiber_core import kinematics
from fiber_core.array_types import Angles, Pairs, Rows, Times
from fiber_core.clearance import gaps
from fiber_core.focal_plane import FocalPlane
from fiber_recording.recording import Recording
from fiber_viewer.figures.plane import draw_fixtures
from fiber_viewer.figures.style import PLANNED
from fiber_viewer.outlines import outlines

__all__ = ["conflict", "conflict_rows", "moments_around"]

_MOMENTS = 6
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")


def conflict_rows(recording: Recording) -> Rows:
    """Return the rows of the pair with the smallest gap, and of the next robot that came near it.

    There are at most three rows; fewer if fewer robots have neighbours.

    Args:
        recording: the recording.
    """
    n = recording.problem.plane.n
    pairs = recording.approaches.pairs  # closest first
    pairs = pairs[(pairs < n).all(axis=1)]
    if not len(pairs):
        return np.zeros(0, dtype=np.int64)
    touching = pairs[np.isin(pairs, pairs[0]).any(axis=1)]
    rows, first = np.unique(touching.ravel(), return_index=True)
    return rows[np.argsort(first)][:3]


def moments_around(time_s: float, end_s: float) -> Times:
    """Return six instants with a given one among them [s], shape (6,).

    Args:
        time_s: the instant that is among them [s].
        end_s: the latest instant [s]; the earliest is 0.
    """
    step = 0.12 * end_s
    first = np.clip(time_s - 3 * step, 0.0, max(0.0, end_s - (_MOMENTS - 1) * step))
    times = first + step * np.arange(_MOMENTS)
    times[np.argmin(np.abs(times - time_s))] = time_s
    return times


def conflict(recording: Recording, rows: ArrayLike | None = None) -> Figure:
    """Draw robots with their outlines at six moments around their closest approach.

    Args:
        recording: the recording.
        rows: rows of the robots, shape (k,); by default those of conflict_rows.

    Returns:
        A figure with six panels. Titles have the time and the smallest gap between two of the
        robots, lines are the ways of the tips up to that time, crosses are targets.
    """
    rows = conflict_rows(recording) if rows is None else np.asarray(rows)
    plane, motion = recording.problem.plane, recording.executed
    among = np.isin(recording.approaches.pairs, rows).all(axis=1)
    pairs = recording.approaches.pairs[among]
    end_s = float(motion.durations[rows].max(initial=0.0)) or motion.makespan_s
    time_s = float(recording.approaches.time_s[among][0]) if len(pairs) else 0.5 * end_s
    figure = Figure(figsize=(11, 8), layout="constrained")
    figure.suptitle("robots " + ", ".join(str(robot) for robot in plane.ids[rows]))
    others = _neighbours_of(recording, rows)
    panels = figure.subplots(2, 3, sharex=True, sharey=True)
    for axes, t in zip(panels.flat, moments_around(time_s, max(end_s, time_s))):
        _draw_moment(axes, recording, rows, others, pairs, t)
    _show_square_around(panels.flat[-1], plane, rows)  # the panels share their axes
    figure.supxlabel("x [mm]")
    figure.supylabel("y [mm]")
    return figure


def _neighbours_of(recording: Recording, rows: Rows) -> Rows:
    pairs = recording.approaches.pairs
    near = np.unique(pairs[np.isin(pairs, rows).any(axis=1)])
    return np.setdiff1d(near[near < recording.problem.plane.n], rows)


def _draw_moment(
    axes: Axes, recording: Recording, rows: Rows, others: Rows, pairs: Pairs, t: float
) -> None:
    """Draw robots in colours and other robots in grey at a time t [s]."""
    plane, motion = recording.problem.plane, recording.executed
    angles = motion(t)
    for row in others:
        _draw_robot(axes, plane, row, angles, PLANNED, 0.3)
    for k, row in enumerate(rows):
        color = _COLORS[k % len(_COLORS)]
        _draw_robot(axes, plane, row, angles, color, 0.75)
        way = np.array(
            [kinematics.forward(plane, motion(s))[1][row] for s in np.linspace(0, t, 60)]
        )
        axes.plot(*way.T, "-", color=color, lw=0.8)
        axes.plot(*recording.problem.targets[row], "+", color="black", ms=9)
        x, y = plane.centers[row]
        axes.annotate(str(plane.ids[row]), (x, y), ha="center", va="top", size=8)
    draw_fixtures(axes, plane)
    title = f"{t:.3f} s"
    if len(pairs):
        title += f"   {gaps(plane, pairs, angles).min():.3f} mm"
    axes.set_title(title, fontsize=10)
    axes.set_aspect("equal")


def _show_square_around(axes: Axes, plane: FocalPlane, rows: Rows) -> None:
    """Set the limits of axes to a square with all that some robots can reach."""
    centers = plane.centers[rows]
    middle = 0.5 * (centers.min(axis=0) + centers.max(axis=0))
    half = 0.5 * np.ptp(centers, axis=0).max() + plane.reach_mm[rows].max()
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)


def _draw_robot(
    axes: Axes, plane: FocalPlane, row: int, angles: Angles, color: str, alpha: float
) -> None:
    elbow, tip = (points[row] for points in kinematics.forward(plane, angles))
    # the phi arm last, because it is above the theta arm
    for order, line in enumerate(reversed(outlines(plane, row, angles))):
        below = order == 0 and plane.theta_vertices.shape[1]
        axes.add_patch(
            Polygon(line, closed=True, facecolor=color, alpha=alpha / (2 if below else 1), lw=0)
        )
    axes.plot(*np.array([plane.centers[row], elbow, tip]).T, "-", color="black", lw=0.8)
    axes.plot(*plane.centers[row], "o", color="black", ms=2.5)
