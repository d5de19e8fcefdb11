# SPDX-License-Identifier: Apache-2.0
"""Progress, alerts and tables of results in a terminal or a log."""

import sys
import time
from collections.abc import Callable, Iterable, Sequence
from typing import TextIO

from rich.console import Console
from rich.progress import (
    BarColumn,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
)
from rich.progress import Progress as Bars
from rich.table import Column

from fiber_client.bus_counters import BusCounterTotals
from fiber_msgs_py import Level, Progress, Status

__all__ = ["ProgressDisplay", "table"]

_LINE_EVERY = 0.25  # of a stage's work, where there are no bars


class ProgressDisplay:
    """Shows the progress of every stage, the traffic on the buses, and alerts.

    In a terminal it shows bars and one line of rates, elsewhere a few plain lines. A client feeds
    it: `PlaneClient(on_progress=display, on_status=display.status)`. `alerts` are the alerts so
    far, `buses` the totals of the buses.

    Args:
        stream: where the lines go.
        clock: returns seconds, for rates.
    """

    def __init__(self, stream: TextIO = sys.stderr, clock: Callable[[], float] = time.monotonic):
        self._stream = stream
        self._bars: Bars | None = None
        self._tasks: dict[str, TaskID] = {}
        self._fractions: dict[str, float] = {}
        self.buses = BusCounterTotals(clock)
        self.alerts: list[str] = []

    def __enter__(self) -> "ProgressDisplay":
        if self._stream.isatty():
            self._bars = _bars(self._stream)
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bars is not None:
            self._bars.stop()

    def say(self, text: str, style: str | None = None) -> None:
        """Write a line.

        Args:
            text: the line.
            style: a style of the library rich, for terminals.
        """
        if self._bars is None:
            print(text, file=self._stream, flush=True)
        else:
            self._bars.console.print(text, markup=False, highlight=False, style=style)

    def __call__(self, progress: Progress) -> None:
        """Show how far a stage is."""
        if self._bars is not None:
            self._update(self._bars, progress.stage, progress.fraction, progress.text)
            return
        before = self._fractions.get(progress.stage, 1.0)
        begins = progress.fraction < before
        if begins or progress.fraction == 1.0 or progress.fraction >= before + _LINE_EVERY:
            self._fractions[progress.stage] = progress.fraction
            self.say(f"{progress.stage:<12} {100 * progress.fraction:3.0f} %  {progress.text}")

    def status(self, status: Status, before: Status | None) -> None:
        """Show the traffic on the buses, and a status that has become worse, once.

        Args:
            status: the status.
            before: the status of the same name that was received before, or None.
        """
        if self.buses.add(status) and self._bars is not None:
            self._update(self._bars, "buses", None, str(self.buses))
        worse = status.level > (Level.OK if before is None else before.level)
        if worse and status.level is not Level.STALE:
            self.alerts.append(f"{status.name}: {status.text}")
            style = "bold red" if status.level is Level.ERROR else "yellow"
            self.say(f"{status.level.name:<12}        {self.alerts[-1]}", style)

    def _update(self, bars: Bars, stage: str, fraction: float | None, text: str) -> None:
        if stage not in self._tasks:
            total = None if fraction is None else 1.0
            self._tasks[stage] = bars.add_task("", total=total, stage=stage)
        task = self._tasks[stage]
        if fraction is not None and fraction < bars.tasks[task].completed:
            bars.reset(task)  # the stage works on another plan
        bars.update(task, completed=fraction, description=text)


def _bars(stream: TextIO) -> Bars:
    # in a narrow terminal the text is cut, not the figures
    return Bars(
        TextColumn("{task.fields[stage]}", table_column=Column(min_width=11)),
        BarColumn(bar_width=None, table_column=Column(min_width=8, max_width=24)),
        TaskProgressColumn(table_column=Column(min_width=4)),
        TimeElapsedColumn(table_column=Column(min_width=7)),
        TextColumn(
            "{task.description}",
            markup=False,
            table_column=Column(no_wrap=True, overflow="ellipsis"),
        ),
        console=Console(file=stream),
    )


def table(rows: Iterable[Sequence[object]]) -> str:
    """Return rows of cells as lines, with aligned columns and numbers to the right."""
    texts = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*texts)]
    lines = []
    for row in texts:
        cells = [
            cell.rjust(width) if cell[:1].isdigit() or cell[:1] == "-" else cell.ljust(width)
            for cell, width in zip(row, widths)
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
