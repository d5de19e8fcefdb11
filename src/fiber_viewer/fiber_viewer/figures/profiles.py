# SPDX-License-Identifier: Apache-2.0
"""Velocity and position profiles of both joints: planned, ordered and measured."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from fiber_core.array_types import Floats, Rows
from fiber_core.motion import SegmentMotion
from fiber_recording.recording import Recording
from fiber_viewer.figures.style import JOINTS, PLANNED, STOPPED

__all__ = ["positions", "velocities"]

_LEAST_VIEW_DEG = 15.0  # of a corridor above and below the curves


_Panels = NDArray[np.object_]  # axes, shape (k, 2): a row for each robot, theta and phi


def _make_panels(
    recording: Recording, rows: ArrayLike, y_label: str
) -> tuple[Figure, Rows, _Panels]:
    rows = np.atleast_1d(rows)
    figure = Figure(figsize=(11, 1.2 + 2.6 * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), 2, sharex=True, squeeze=False)
    for row, pair in zip(rows, panels):
        for (joint, _), axes in zip(JOINTS, pair):
            axes.set_title(f"robot {recording.problem.plane.ids[row]}, {joint}", fontsize=10)
            axes.grid(color="#e5e5e5")
            for begin_s, end_s in recording.pauses_s:
                axes.axvspan(begin_s, end_s, color=STOPPED, alpha=0.15, lw=0, label="all stopped")
        pair[0].set_ylabel(y_label)
    ends_s = recording.executed.durations[rows].max(initial=0.0)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
        if ends_s > 0:  # other robots may move for much longer
            axes.set_xlim(-0.02 * ends_s, 1.15 * ends_s)
    return figure, rows, panels


def _segments(motion: SegmentMotion, row: int, joint: int) -> tuple[Floats, Floats]:
    """Durations [s] and velocities [rad/s] of the segments of a joint."""
    chosen = motion.parts.slice(2 * row + joint)
    return motion.duration_s[chosen], motion.velocity_rad_s[chosen]


def velocities(recording: Recording, rows: ArrayLike) -> Figure:
    """Draw velocities of both joints: the planned ones, the executed segments, and the limits.

    Args:
        recording: the recording.
        rows: rows of robots, shape (k,); one row of panels for each.
    """
    figure, rows, panels = _make_panels(recording, rows, "velocity [deg/s]")
    motion, planned = recording.executed, recording.planned
    for row, pair in zip(rows, panels):
        for joint, axes in enumerate(pair):
            if planned is not None:
                speed = np.diff(planned.angles[row, joint]) / np.diff(planned.time_s)
                axes.stairs(
                    np.rad2deg(speed), planned.time_s, baseline=None, color=PLANNED, label="planned"
                )
            lasts, speed = _segments(motion, row, joint)
            edges = np.concatenate([[0.0], np.cumsum(lasts)])
            axes.stairs(
                np.rad2deg(speed), edges, baseline=0.0, color=JOINTS[joint][1], lw=2, label="sent"
            )
            limit = np.rad2deg(recording.problem.plane.speeds[row, joint])
            for sign in (-1, 1):
                axes.axhline(sign * limit, ls="--", lw=0.9, color="black")
            axes.set_ylim(-1.15 * limit, 1.15 * limit)
    _draw_legend(panels[0, 0])
    return figure


def positions(recording: Recording, rows: ArrayLike) -> Figure:
    """Draw angles of both joints: the planned ones, the executed segments, readings, corridors.

    The corridor of a joint is drawn until its robot was stopped.

    Args:
        recording: the recording.
        rows: rows of robots, shape (k,); one row of panels for each.
    """
    figure, rows, panels = _make_panels(recording, rows, "position [deg]")
    motion, planned, measured = recording.executed, recording.planned, recording.measured
    for row, pair in zip(rows, panels):
        own = measured.row == row
        for joint, axes in enumerate(pair):
            if planned is not None:
                curve = planned.angles[row, joint]
                axes.plot(planned.time_s, np.rad2deg(curve), color=PLANNED, label="planned")
            lasts, speed = _segments(motion, row, joint)
            times = np.concatenate([[0.0], np.cumsum(lasts)])
            angles = motion.start[row, joint] + np.concatenate([[0.0], np.cumsum(lasts * speed)])
            axes.plot(
                np.append(times, max(motion.makespan_s, times[-1])),
                np.rad2deg(np.append(angles, angles[-1])),
                "-o", ms=4, lw=1.8, color=JOINTS[joint][1], label="sent",
                markevery=range(len(times)),
            )  # fmt: skip
            axes.plot(
                measured.time_us[own] * 1e-6,
                np.rad2deg(recording.units.to_angles(measured.counts[own, joint])),
                "o", ms=5, mfc="none", mec="black", mew=0.8, label="encoder",
            )  # fmt: skip
            _draw_corridor(axes, recording, row, joint)
    _draw_legend(panels[0, 0])
    return figure


def _draw_corridor(axes: Axes, recording: Recording, row: int, joint: int) -> None:
    """Draw a corridor, grey where the joint must not be, and set the limits of the axes.

    Curves stay legible: of a wide corridor no more is shown, above and below, than the height of
    the curves.
    """
    curves = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.lines])
    low, high = curves.min(), curves.max()
    below = above = 0.0
    bounds, shown = None, np.empty(0)
    corridors = recording.corridors
    if corridors is not None and corridors.lasts_s[row] > 0:
        time_s, until_s = corridors.times_s(row), recording.active_s[0, row, 1]
        shown = np.append(time_s[time_s < until_s], min(until_s, time_s[-1]))
        bounds = np.rad2deg(
            [np.interp(shown, time_s, w[row, joint]) for w in (corridors.low, corridors.high)]
        )
        for bound in bounds:
            axes.plot(shown, bound, color=PLANNED, lw=0.7)
        most = max(high - low, _LEAST_VIEW_DEG)
        below = min(low - min(low, bounds[0].min()), most)
        above = min(max(high, bounds[1].max()) - high, most)
    pad = max(0.06 * (high - low + below + above), 1.0)
    bottom, top = low - below - pad, high + above + pad
    axes.set_ylim(bottom, top)
    if bounds is not None:
        for edge, bound in ((bottom, bounds[0]), (top, bounds[1])):
            axes.fill_between(
                shown, edge, bound, color=PLANNED, alpha=0.28, lw=0, label="outside the corridor"
            )


def _draw_legend(axes: Axes) -> None:
    """Draw the legend with each label once."""
    named = dict(zip(*reversed(axes.get_legend_handles_labels())))
    axes.legend(named.values(), named, loc="best", fontsize=8)
