# SPDX-License-Identifier: Apache-2.0
"""Figure of calibrated numbers of robots over nights, for the night log."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from fiber_core.array_types import Bools, Floats, Ids

__all__ = ["trends"]

_COLUMNS = 3
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")


def trends(
    names: Sequence[str], ids: Ids, numbers: Floats, errors: Floats, per_night: Floats,
    drifts: Bools,
) -> Figure:  # fmt: skip
    """Draw each number of some robots over nights, less its mean, with its error.

    A straight line is drawn for each number that drifts.

    Args:
        names: names of the numbers, with their units.
        ids: robot ids, shape (k,).
        numbers, errors: numbers of each night and their standard errors, shape
            (nights, k, len(names)), nan where a robot has none.
        per_night: slopes, shape (k, len(names)).
        drifts: which of them drift, shape (k, len(names)).
    """
    rows = -(-len(names) // _COLUMNS)
    figure = Figure(figsize=(4.0 * _COLUMNS, 2.3 * rows), layout="constrained")
    grid = figure.subplots(rows, _COLUMNS, squeeze=False, sharex=True)
    nights = np.arange(len(numbers))
    for k, (axes, name) in enumerate(zip(grid.flat, names)):
        axes.set_title(name, fontsize="medium")
        axes.grid(color="#e5e5e5")
        axes.set_axisbelow(True)
        for robot, robot_id in enumerate(ids):
            value, colour = numbers[:, robot, k], _COLOURS[robot % len(_COLOURS)]
            good = np.isfinite(value)
            if not good.any():
                continue
            off = value - value[good].mean()
            axes.errorbar(
                nights, off, errors[:, robot, k], fmt="o", ms=3, lw=1, color=colour,
                label=f"robot {robot_id}",
            )  # fmt: skip
            if drifts[robot, k]:
                line = per_night[robot, k] * (nights - nights[good].mean())
                axes.plot(nights, line, color=colour, lw=1.5)
    for axes in grid[-1]:
        axes.set_xlabel("night")
        axes.xaxis.get_major_locator().set_params(integer=True)
    handles, labels = grid.flat[0].get_legend_handles_labels()
    figure.suptitle("numbers less their mean" if len(ids) else "no robot drifts")
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(handles))
    return figure
