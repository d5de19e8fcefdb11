# SPDX-License-Identifier: Apache-2.0
"""Figures of a recording, for papers and for the night log; each function returns a Figure."""

from fiber_viewer.figures.conflict import conflict, conflict_rows
from fiber_viewer.figures.plane import before_and_after, outcomes, plane
from fiber_viewer.figures.profiles import positions, velocities
from fiber_viewer.figures.residuals import images, residuals
from fiber_viewer.figures.statistics import bus_load, clearances, makespan, segments
from fiber_viewer.figures.trends import trends

__all__ = [
    "before_and_after",
    "bus_load",
    "clearances",
    "conflict",
    "conflict_rows",
    "images",
    "makespan",
    "outcomes",
    "plane",
    "positions",
    "residuals",
    "segments",
    "trends",
    "velocities",
]
