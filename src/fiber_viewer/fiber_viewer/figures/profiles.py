"""Velocities and positions of both motors: planned curve, margin, segments, encoder readings."""

import numpy as np
from matplotlib.figure import Figure

from fiber_viewer.figures.style import JOINTS, PLANNED
from fiber_viewer.recording import Recording

__all__ = ["positions", "velocities"]


def _panels(recording, rows, name):
    rows = np.atleast_1d(rows)
    figure = Figure(figsize=(11, 1.2 + 2.6 * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), 2, sharex=True, squeeze=False)
    for row, pair in zip(rows, panels):
        for (joint, _), axes in zip(JOINTS, pair):
            axes.set_title(f"robot {recording.problem.plane.ids[row]}, {joint}", fontsize=10)
            axes.grid(color="#e5e5e5")
        pair[0].set_ylabel(name)
    ends_s = recording.decoded.durations[rows].max(initial=0.0)
    for axes in panels[-1]:
        axes.set_xlabel("time [s]")
        if ends_s > 0:  # not the whole plane's time: others may move for long
            axes.set_xlim(-0.02 * ends_s, 1.15 * ends_s)
    return figure, rows, panels


def _segments(motion, row, joint):
    chosen = slice(*motion.offsets[2 * row + joint : 2 * row + joint + 2])
    return motion.duration_s[chosen], motion.velocity_rad_s[chosen]


def velocities(recording: Recording, rows) -> Figure:
    """Draw the speeds of both motors: planned curve, segments as sent as steps, limits.

    Args:
        recording: the reconfiguration.
        rows: robots, shape (k,); one row of panels each.
    """
    figure, rows, panels = _panels(recording, rows, "velocity [deg/s]")
    motion, planned = recording.decoded, recording.planned
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
    panels[0, 0].legend(loc="best", fontsize=8)
    return figure


def positions(recording: Recording, rows, margin_rad=None) -> Figure:
    """Draw the positions of both motors: planned curve, margin, segments, encoder readings.

    Args:
        recording: the reconfiguration.
        rows: robots, shape (k,); one row of panels each.
        margin_rad: how far each joint of these robots may leave its planned curve at the
            planned times [rad], shape (k, 2, t), as fiber_discretizer.margin gives it; by
            default no band, for the graph does not publish it.
    """
    figure, rows, panels = _panels(recording, rows, "position [deg]")
    motion, planned, measured = recording.decoded, recording.planned, recording.measured
    for k, (row, pair) in enumerate(zip(rows, panels)):
        heard = measured.row == row
        for joint, axes in enumerate(pair):
            if planned is not None:
                curve = planned.angles[row, joint]
                axes.plot(planned.time_s, np.rad2deg(curve), color=PLANNED, label="planned")
                if margin_rad is not None:
                    band = np.rad2deg([curve - margin_rad[k, joint], curve + margin_rad[k, joint]])
                    axes.fill_between(
                        planned.time_s, *band, color=PLANNED, alpha=0.25, lw=0, label="margin"
                    )
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
                measured.time_us[heard] * 1e-6,
                np.rad2deg(recording.units.to_angles(measured.counts[heard, joint])),
                "o", ms=5, mfc="none", mec="black", mew=0.8, label="encoder",
            )  # fmt: skip
    panels[0, 0].legend(loc="best", fontsize=8)
    return figure
