# SPDX-License-Identifier: Apache-2.0
"""The picture of a study: its figures over the parameter that varies most."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fiber_positioners.study.cases import Case
from fiber_positioners.study.results import FIGURES, Summary

__all__ = ["study_figure"]

# column -> label of the axis
_AXES = {
    "pitch_mm": "pitch [mm]",
    "arm_theta_mm": "theta arm [mm]",
    "arm_phi_mm": "phi arm [mm]",
    "radius_mm": "radius of the phi arm [mm]",
    "disabled": "share of disabled robots",
    "robots": "robots",
}


def study_figure(summaries: Sequence[Summary]) -> Figure:
    """Draw a panel of each figure: robots that reached their targets, makespan, segments, bytes.

    The horizontal axis is the parameter with the most values; cases that differ in others are
    lines of their own. Bars reach from the least to the greatest draw, and
    every draw is a dot.

    Args:
        summaries: the summaries of the study.
    """
    figure = Figure(figsize=(13, 7), layout="constrained")
    columns = [each.case.columns() for each in summaries]
    axis = max(_AXES, key=lambda name: len({column[name] for column in columns}), default="robots")
    lines: dict[str, list[Summary]] = {}
    for each in summaries:
        lines.setdefault(_line_name(each.case, axis, columns), []).append(each)
    panels = figure.subplots(2, (len(FIGURES) + 1) // 2).flat
    for (name, (heading, _)), axes in zip(FIGURES.items(), panels):
        for label, cases in lines.items():
            drawn = [each for each in cases if name in each.figures]
            x = [_number(each.case.columns()[axis]) for each in drawn]
            spreads = [each.figures[name] for each in drawn]
            mean = np.array([spread.mean for spread in spreads])
            below = mean - [spread.least for spread in spreads]
            above = np.array([spread.greatest for spread in spreads]) - mean
            line = axes.errorbar(x, mean, yerr=[below, above], fmt="o-", capsize=3, label=label)
            draws = [(at, value) for at, each in zip(x, drawn) for value in each.draws[name]]
            if draws:
                axes.plot(*zip(*draws), ".", color=line.lines[0].get_color(), ms=4, alpha=0.6)
        axes.set_xlabel(_AXES[axis])
        axes.set_title(heading)
        axes.grid(alpha=0.3)
    for axes in panels:
        axes.set_axis_off()
    if len(lines) > 1:
        figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center")
    return figure


def save_figure(path: Path, summaries: Sequence[Summary]) -> None:
    """Write the picture of a study as PNG."""
    study_figure(summaries).savefig(path, dpi=120)


def _line_name(case: Case, axis: str, columns: Sequence[dict[str, object]]) -> str:
    """The values of a case in the parameters that vary, other than the axis."""
    own = case.columns()
    varies = [
        name for name in own if name != axis and len({column[name] for column in columns}) > 1
    ]
    if axis == "arm_theta_mm" and all(c["arm_theta_mm"] == c["arm_phi_mm"] for c in columns):
        varies.remove("arm_phi_mm")
    return ", ".join(f"{name} {own[name]}" for name in varies)


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else np.nan
