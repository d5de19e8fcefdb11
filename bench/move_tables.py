#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Real move tables of DESI: how long petals move, how many motors run at once, and the bound.

A table has one line a positioner: for each of its rows the motor steps of phi (P) and theta (T),
the mode (cruise or creep), the time of the row [s] and the pause after it [ms]. Both motors of a
row start together; each runs for its steps at its speed. A plan.npz beside them is read by its true
curves.

    python3 bench/move_tables.py desi/hwtables_*.csv out/motors/plan.npz --figure out/motors.png
"""

import argparse
import ast
import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

CREEP_STEPS_S = 9000.0  # from the tables: time of a row against its steps
CRUISE_STEPS_S = 18_000.0
RAMPS_S = 0.0453  # both ramps of a cruise move, beyond its steps at full speed
COLUMNS = (
    "table", "positioners", "time [s]", "motor time [s]", "of it creep", "most motors on", "mean"
)  # fmt: skip
_MOTORS = 2  # of a positioner
_CREEPS = 0.5  # share of the fastest speed below which a piece of a curve is creep
_FOLLOWS_S = 2e-3  # largest difference between a row's time and the one of our speeds


class TableError(Exception):
    """A line of a move table that is not understood."""


@dataclass(frozen=True, eq=False)
class Runs:
    """The runs of all motors of a table.

    Args:
        positioners: number of positioners in the table.
        begin_s, end_s: when each run begins and ends [s], shape (r,).
        creeps: whether it is in creep, shape (r,).
    """

    positioners: int
    begin_s: np.ndarray
    end_s: np.ndarray
    creeps: np.ndarray

    @property
    def total_s(self) -> float:
        """When the last motor stops [s]."""
        return float(self.end_s.max(initial=0.0))

    @property
    def motor_s(self) -> float:
        """Time of all motors together [s]."""
        return float((self.end_s - self.begin_s).sum())

    def bound_s(self, share: float) -> float:
        """Return the least time of the same runs with a share of all motors on at most [s]."""
        return self.motor_s / (share * _MOTORS * self.positioners)

    def share_on(self, times: np.ndarray) -> np.ndarray:
        """Return the share of all motors that run at some times [s], shape as times."""
        begun = np.searchsorted(np.sort(self.begin_s), times, side="right")
        ended = np.searchsorted(np.sort(self.end_s), times, side="right")
        return (begun - ended) / (_MOTORS * self.positioners)

    @property
    def peak(self) -> float:
        """Largest share of all motors that run at once."""
        return float(self.share_on(self.begin_s).max(initial=0.0))


def run_time_s(steps: float, mode: str) -> float:
    """Return how long a motor runs for some steps [s]."""
    if mode == "creep":
        return abs(steps) / CREEP_STEPS_S
    return abs(steps) / CRUISE_STEPS_S + RAMPS_S if steps else 0.0


def read_runs(path: Path) -> Runs:
    """Read a table.

    Raises:
        TableError: a line has lists of different lengths, an unknown mode, or a time that the
            speeds of cruise and creep do not explain; names positioner, row and value.
    """
    begin: list[float] = []
    end: list[float] = []
    creeps: list[bool] = []
    positioners = 0
    with open(path, newline="", encoding="utf-8") as file:
        for line in csv.DictReader(file):
            positioners += 1
            now = 0.0
            for k, row in enumerate(_rows_of(line)):
                longest = 0.0
                for steps, mode in ((row[0], row[2]), (row[1], row[3])):
                    lasts = run_time_s(steps, mode)
                    longest = max(longest, lasts)
                    if steps:
                        begin.append(now)
                        end.append(now + lasts)
                        creeps.append(mode == "creep")
                if abs(longest - row[4]) > _FOLLOWS_S:
                    raise TableError(
                        f"{path.name}: positioner {line['posid']} row {k} takes {row[4]} s, "
                        f"its speeds say {longest:.4f} s"
                    )
                now += row[4] + row[5] / 1e3
    return Runs(positioners, np.array(begin), np.array(end), np.array(creeps, dtype=bool))


def read_plan(path: Path) -> Runs:
    """Read the motors of all robots of a plan.npz from its true curves, a run for each piece.

    Raises:
        TableError: the file is no plan, or has no curves.
    """
    names = ("curve_offsets", "curve_time_s", "curve_velocity_rad_s", "curve_acceleration_rad_s2")
    try:
        with np.load(path) as plan:
            offsets, begin_s, speed, change = (plan[name] for name in names)
    except (KeyError, ValueError, OSError) as error:
        raise TableError(f"{path.name} is no plan with true curves: {error}") from None
    at_once = np.abs(speed)
    moves = (at_once > 0.0) | (change != 0.0)  # the last piece of each motor is its rest
    end_s, creeps = np.roll(begin_s, -1), at_once < _CREEPS * at_once.max(initial=0.0)
    return Runs((len(offsets) - 1) // _MOTORS, begin_s[moves], end_s[moves], creeps[moves])


def _rows_of(line: dict[str, str]) -> list[tuple[float, float, str, str, float, float]]:
    # steps of phi and theta, their modes, time [s] and pause [ms] of each row
    names = ("motor_steps_P", "motor_steps_T", "speed_mode_P", "speed_mode_T")
    columns = [ast.literal_eval(line[name]) for name in (*names, "move_time", "postpause")]
    lengths = {len(column) for column in columns}
    if len(lengths) != 1:
        raise TableError(f"positioner {line['posid']} has lists of {sorted(lengths)} rows")
    unknown = {*columns[2], *columns[3]} - {"creep", "cruise"}
    if unknown:
        raise TableError(f"positioner {line['posid']} has the mode {sorted(unknown)[0]!r}")
    return list(zip(*columns))


def line_of(name: str, runs: Runs, cap: float) -> str:
    """Return the line of a table of results."""
    creep = runs.end_s[runs.creeps].sum() - runs.begin_s[runs.creeps].sum()
    cells = (
        name,
        runs.positioners,
        f"{runs.total_s:.2f}",
        f"{runs.motor_s:.0f}",
        f"{creep / runs.motor_s:.0%}",
        f"{runs.peak:.0%}",
        f"{runs.motor_s / (_MOTORS * runs.positioners * runs.total_s):.0%}",
        f"{runs.bound_s(cap):.2f}",
    )
    return "| " + " | ".join(map(str, cells)) + " |"


def draw(path: Path, tables: Sequence[tuple[str, Runs]], cap: float) -> None:
    """Draw the share of motors that run over time, against the cap and the bound."""
    from matplotlib.figure import Figure

    longest_s = max(runs.total_s for _, runs in tables)
    figure = Figure(figsize=(7.0, 2.4 * len(tables)), layout="constrained")
    for axes, (name, runs) in zip(figure.subplots(len(tables), squeeze=False)[:, 0], tables):
        times = np.linspace(0.0, runs.total_s, 2000)
        axes.fill_between(times, runs.share_on(times), color="tab:blue", alpha=0.5, lw=0)
        axes.axhline(cap, color="tab:red", lw=1, label=f"cap, {cap:.0%}")
        axes.axvline(runs.bound_s(cap), color="k", ls="--", lw=1, label="bound under the cap")
        axes.set(title=name, xlabel="time [s]", ylabel="motors on", ylim=(0, 1))
        axes.set_xlim(0.0, 1.02 * longest_s)
        axes.legend(loc="upper right", fontsize="small")
    figure.savefig(path, dpi=100)


def main(arguments: Sequence[str] | None = None) -> int:
    """Read tables and print a line for each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("tables", nargs="+", type=Path)
    parser.add_argument("--cap", type=float, default=0.55, help="share of motors on at once")
    parser.add_argument("--figure", type=Path)
    args = parser.parse_args(arguments)
    if not 0.0 < args.cap <= 1.0:
        parser.error(f"--cap is {args.cap}, expected more than 0 and at most 1")
    try:
        tables = [
            (path.stem, read_plan(path) if path.suffix == ".npz" else read_runs(path))
            for path in args.tables
        ]
    except (TableError, KeyError, ValueError, OSError) as error:
        print(f"move_tables: {error}", file=sys.stderr)
        return 1
    header = (*COLUMNS, f"bound with {args.cap:.0%} on [s]")
    print(f"| {' | '.join(header)} |")
    print("|" + "---|" * len(header))
    for name, runs in tables:
        print(line_of(name, runs, args.cap))
    if args.figure is not None:
        draw(args.figure, tables, args.cap)
    return 0


if __name__ == "__main__":
    sys.exit(main())
