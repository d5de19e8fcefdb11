# SPDX-License-Identifier: Apache-2.0
"""Residuals: how far fibres are from their targets in each image of a closed loop."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from fiber_core.array_types import Points
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import STILL, Outcome
from fiber_recording.errors import RecordingError
from fiber_recording.recording import Recording
from fiber_viewer.figures.style import COLORS

__all__ = ["images", "residuals"]

_MOST_PITCHES = 1.5  # of the longest usual vector
_BINS = 40
_SHOWN_PERCENT = 99  # of the lengths of an image are inside its histogram


def images(recording: Recording) -> Figure:
    """Draw what a camera told after a plan and its corrections, as `residuals`.

    Fibres of robots that the plan brought to their targets are shown. Robots that did not move are
    crosses.

    Args:
        recording: the recording, with images.

    Raises:
        RecordingError: no camera has seen the plan.
    """
    seen = recording.images
    if seen is None:
        raise RecordingError("images: no camera has seen this plan")
    plane = recording.problem.plane
    reached = (recording.outcome == Outcome.REACHED)[:, None]
    targets = np.where(reached, recording.problem.targets, np.nan)
    still = np.isin(seen.verdict, STILL).any(axis=0)
    return residuals(plane, targets, list(seen.place_mm), plane.ids[still])


def residuals(
    plane: FocalPlane, targets: ArrayLike, places: Sequence[ArrayLike], flagged: ArrayLike = ()
) -> Figure:
    """Draw the vector from each target to its fibre, and a histogram of their lengths, by image.

    The vectors of one image have one scale, which its title tells: the 95th percentile is drawn as
    long as one and a half pitches. The last bar of a histogram counts all longer ones too.

    Args:
        plane: the focal plane.
        targets: targets of the fibres [mm], shape (n, 2), nan without one, and for robots that the
            plan held: they are far from it, and say nothing of the images.
        places: measured places of the fibres in each image [mm], shape (n, 2) each, nan where
            none is told.
        flagged: ids of robots that did not move when they were told to, marked and not counted.

    Returns:
        A figure with two panels an image.
    """
    wanted = np.asarray(targets, dtype=float)
    still = np.isin(plane.ids, np.asarray(flagged, dtype=np.int64))
    columns = max(len(places), 1)
    figure = Figure(figsize=(6.0 * columns, 9.0), layout="constrained")
    panels = figure.subplots(2, columns, squeeze=False, height_ratios=[2, 1])
    for number, found in enumerate(places):
        off = np.asarray(found, dtype=float) - wanted
        shown = np.isfinite(off).all(axis=1) & ~still
        um = 1e3 * np.hypot(*off[shown].T)
        above, below = panels[:, number]
        _draw_vectors(above, plane, wanted[shown], off[shown], um)
        above.plot(*plane.centers[still].T, "x", color=COLORS["failed"], ms=6)
        name = "after the move" if number == 0 else f"after correction {number}"
        rms = float(np.sqrt(np.mean(um**2))) if len(um) else float("nan")
        above.set_title(f"{name}: {len(um)} fibres, {rms:.1f} um rms\n{above.get_title()}")
        far = max(float(np.percentile(um, _SHOWN_PERCENT)), 1e-3) if len(um) else 1.0
        below.hist(np.minimum(um, far), np.linspace(0.0, far, _BINS + 1), color=COLORS["reached"])
        below.set_xlabel("distance from the target [um], the last bar counts longer ones too")
    panels[0, 0].set_ylabel("y [mm]")
    panels[1, 0].set_ylabel("fibres")
    if still.any():
        figure.suptitle(f"crosses: {still.sum()} robots did not move: {_named(plane, still)}")
    return figure


def _draw_vectors(axes, plane: FocalPlane, at: Points, off: Points, um: np.ndarray) -> None:
    axes.set_aspect("equal")
    axes.set_xlabel("x [mm]")
    axes.plot(*plane.centers.T, ".", color="0.8", ms=1)
    if len(um):
        usual_mm = max(float(np.percentile(um, 95)) * 1e-3, 1e-6)
        scale = _MOST_PITCHES * plane.arms.sum(axis=1).max() / usual_mm
        axes.quiver(*at.T, *(scale * off).T, angles="xy", scale_units="xy", scale=1.0, width=2e-3)
        axes.set_title(f"vectors {scale:.0f} times as long")


def _named(plane: FocalPlane, rows: np.ndarray, most: int = 8) -> str:
    ids = plane.ids[rows].tolist()
    return ", ".join(map(str, ids[:most])) + (" ..." if len(ids) > most else "")
