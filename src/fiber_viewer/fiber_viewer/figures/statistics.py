# SPDX-License-Identifier: Apache-2.0
"""Figures for the night log: clearances, makespan, segments and bus load of a plan."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fiber_recording.recording import EventKind, Recording
from fiber_viewer.figures.style import JOINTS, STOPPED

__all__ = ["bus_load", "clearances", "makespan", "segments"]

_FAR_MM = 3.0  # larger gaps are counted together


def _make_axes(title: str, x_label: str, y_label: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axes = figure.subplots()
    axes.set_title(title)
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.grid(color="#e5e5e5")
    axes.set_axisbelow(True)
    return figure, axes


def clearances(recording: Recording) -> Figure:
    """Draw a histogram of the smallest gaps of all pairs of neighbours, and the margin.

    Args:
        recording: the recording.
    """
    gap, about = recording.approaches.gap_mm, recording.about
    least = about["report"]["min_clearance_mm"]
    title = "no robot has neighbours" if least is None else f"least clearance {least:.4f} mm"
    if nearer := about["report"].get("nearer_from_start"):
        title += f", {len(nearer)} pairs nearer from the start"
    figure, axes = _make_axes(title, "smallest gap of a pair [mm]", "pairs")
    axes.hist(np.minimum(gap, _FAR_MM), bins=np.linspace(0, _FAR_MM, 61).tolist(), color="#0072B2")
    axes.set_xlabel(f"smallest gap of a pair [mm], the last bar is {_FAR_MM:g} mm and more")
    margin = about["certificate"]["margin_mm"]
    axes.axvline(margin, color="#D55E00", lw=1.5, label=f"margin {margin:g} mm")
    axes.set_yscale("symlog", linthresh=10)
    axes.legend()
    return figure


def makespan(recording: Recording) -> Figure:
    """Draw the number of moving robots over time, the makespan and its lower bound.

    Args:
        recording: the recording.
    """
    report, motion = recording.about["report"], recording.executed
    begins, ends = recording.active_s[np.isfinite(recording.active_s[..., 0])].T
    times, at = np.unique(np.concatenate([begins, ends, [0.0]]), return_inverse=True)
    change = np.concatenate([np.ones(len(begins)), -np.ones(len(ends)), [0.0]])
    moving = np.cumsum(np.bincount(at, change))[:-1]
    figure, axes = _make_axes(
        f"makespan {motion.makespan_s:.3f} s, lower bound {report['lower_bound_s']:.3f} s",
        "time [s]",
        "robots moving",
    )
    if len(moving):
        axes.stairs(moving, times, fill=True, color="#56B4E9")
    for begin_s, end_s in recording.pauses_s:
        axes.axvspan(begin_s, end_s, color=STOPPED, alpha=0.25, lw=0, label="all stopped")
    axes.axvline(report["lower_bound_s"], color="black", ls="--", lw=1, label="lower bound")
    axes.axvline(motion.makespan_s, color="#D55E00", lw=1.5, label="makespan")
    axes.set_xlim(0, 1.05 * max(motion.makespan_s, report["lower_bound_s"], 1e-3))
    axes.set_ylim(bottom=0)
    named = dict(zip(*reversed(axes.get_legend_handles_labels())))
    axes.legend(named.values(), named)
    return figure


def segments(recording: Recording) -> Figure:
    """Draw a histogram of the number of segments in an order of a motor that moves.

    Args:
        recording: the recording.
    """
    counts = recording.order_segments.reshape(-1, 2)
    moving = counts[counts > 0]
    mean = moving.mean() if len(moving) else 0.0
    figure, axes = _make_axes(
        f"{mean:.2f} segments per moving motor", "segments", "orders of motors"
    )
    most = max(int(counts.max(initial=1)), 1)
    for joint, (name, color) in enumerate(JOINTS):
        tall = np.bincount(counts[:, joint], minlength=most + 1)[1:]
        at = np.arange(1, most + 1) + (joint - 0.5) * 0.38
        axes.bar(at, tall, 0.36, color=color, label=name)
    axes.set_xticks(np.arange(1, most + 1))
    axes.set_yscale("symlog", linthresh=10)
    axes.legend()
    return figure


def bus_load(recording: Recording) -> Figure:
    """Draw the data rate of every bus over time, with GO, STOP and faults.

    Args:
        recording: the recording.
    """
    load, events = recording.load, recording.events
    figure, axes = _make_axes(
        f"{load.frames.sum()} frames, {load.bytes.sum()} bytes on {len(load.buses)} buses",
        "time from the begin of the motion [s]",
        "bus",
    )
    axes.grid(False)
    edges = np.arange(len(load.buses) + 1) - 0.5
    mesh = axes.pcolormesh(
        load.edges_s, edges, load.bytes / load.bin_s * 1e-3, cmap="cividis", rasterized=True
    )
    figure.colorbar(mesh, label="kB/s")
    rows = np.searchsorted(load.buses, events.bus)
    faults = events.unexpected
    if faults.any():
        axes.plot(events.time_s[faults], rows[faults], "X", color="#D55E00", ms=7, label="fault")
        axes.legend()
    for kind, color in ((EventKind.GO, "white"), (EventKind.STOP, "#D55E00")):
        for time_s in np.unique(events.time_s[events.kind == kind]):
            axes.axvline(time_s, color=color, lw=1)
    step = -(-len(load.buses) // 20)
    axes.set_yticks(np.arange(0, len(load.buses), step), load.buses[::step])
    return figure
