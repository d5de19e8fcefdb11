"""Robots that come near each other, at six moments: figure 5 of the discretization paper."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from fiber_core import kinematics
from fiber_core.clearance import gaps
from fiber_recording.recording import Recording
from fiber_viewer.figures.plane import draw_discs
from fiber_viewer.figures.style import PLANNED
from fiber_viewer.outlines import outlines

__all__ = ["conflict", "conflict_rows", "moments_around"]

_MOMENTS = 6
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")


def conflict_rows(recording: Recording) -> np.ndarray:
    """Return the rows of the pair that came nearest to each other, and of who came nearest to it.

    At most three, fewer on a plane where fewer robots meet.
    """
    n = recording.problem.plane.n
    pairs = recording.approaches.pairs  # nearest first
    pairs = pairs[(pairs < n).all(axis=1)]
    if not len(pairs):
        return np.zeros(0, dtype=np.int64)
    touching = pairs[np.isin(pairs, pairs[0]).any(axis=1)]
    rows, first = np.unique(touching.ravel(), return_index=True)
    return rows[np.argsort(first)][:3]


def moments_around(time_s: float, end_s: float) -> np.ndarray:
    """Return six times from 0 to an end [s], a given one among them."""
    step = 0.12 * end_s
    first = np.clip(time_s - 3 * step, 0.0, max(0.0, end_s - (_MOMENTS - 1) * step))
    times = first + step * np.arange(_MOMENTS)
    times[np.argmin(np.abs(times - time_s))] = time_s
    return times


def conflict(recording: Recording, rows=None) -> Figure:
    """Draw robots with their outlines at six moments around their closest approach.

    Args:
        recording: the reconfiguration.
        rows: the robots, shape (k,); by default as from conflict_rows.

    Returns:
        A figure of six panels with time and the least gap between any two of the robots;
        the tips' ways up to then are lines, targets are crosses.
    """
    rows = conflict_rows(recording) if rows is None else np.asarray(rows)
    plane, motion = recording.problem.plane, recording.executed
    among = np.isin(recording.approaches.pairs, rows).all(axis=1)
    pairs = recording.approaches.pairs[among]
    end_s = float(motion.durations[rows].max(initial=0.0)) or motion.makespan_s
    time_s = float(recording.approaches.time_s[among][0]) if len(pairs) else 0.5 * end_s
    figure = Figure(figsize=(11, 8), layout="constrained")
    figure.suptitle("robots " + ", ".join(str(robot) for robot in plane.ids[rows]))
    near = _neighbours(recording, rows)
    for axes, t in zip(figure.subplots(2, 3, sharex=True, sharey=True).flat,
                       moments_around(time_s, max(end_s, time_s))):  # fmt: skip
        angles = motion(t)
        for row in near:
            _draw_robot(axes, plane, row, angles, PLANNED, 0.3)
        for row, color in zip(rows, _colors(len(rows))):
            _draw_robot(axes, plane, row, angles, color, 0.75)
            ways = np.array(
                [kinematics.forward(plane, motion(s))[1][row] for s in np.linspace(0, t, 60)]
            )
            axes.plot(*ways.T, "-", color=color, lw=0.8)
            axes.plot(*recording.problem.targets[row], "+", color="black", ms=9)
            axes.annotate(str(plane.ids[row]), plane.centers[row], ha="center", va="top", size=8)
        draw_discs(axes, plane.obstacles)
        title = f"{t:.3f} s"
        if len(pairs):
            title += f"   {gaps(plane, pairs, angles).min():.3f} mm"
        axes.set_title(title, fontsize=10)
        axes.set_aspect("equal")
    centers = plane.centers[rows]
    middle = 0.5 * (centers.min(axis=0) + centers.max(axis=0))
    half = 0.5 * np.ptp(centers, axis=0).max() + plane.reach_mm[rows].max()
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    figure.supxlabel("x [mm]")
    figure.supylabel("y [mm]")
    return figure


def _colors(count):
    return [_COLORS[i % len(_COLORS)] for i in range(count)]


def _neighbours(recording, rows):
    pairs = recording.approaches.pairs
    near = np.unique(pairs[np.isin(pairs, rows).any(axis=1)])
    return np.setdiff1d(near[near < recording.problem.plane.n], rows)


def _draw_robot(axes, plane, row, angles, color, alpha):
    elbow, tip = (points[row] for points in kinematics.forward(plane, angles))
    # the phi link last: it is the upper one
    for order, line in enumerate(reversed(outlines(plane, row, angles))):
        below = order == 0 and plane.theta_vertices.shape[1]
        axes.add_patch(
            Polygon(line, closed=True, facecolor=color, alpha=alpha / (2 if below else 1), lw=0)
        )
    axes.plot(*np.array([plane.centers[row], elbow, tip]).T, "-", color="black", lw=0.8)
    axes.plot(*plane.centers[row], "o", color="black", ms=2.5)
