"""What a terminal shows: progress of the stages, and tables."""

import sys
import time
from collections.abc import Callable

from fiber_client.bus_counters import BusCounterTotals
from fiber_msgs_py import Level, Progress, Status

__all__ = ["ProgressDisplay", "table"]

_LINE_EVERY = 0.25  # of a stage's work, where there are no bars


class ProgressDisplay:
    """Shows the progress of every stage, what the buses carry, and alerts.

    Bars and one line of rates in a terminal, a few plain lines elsewhere. It is what a
    PlaneClient tells: `PlaneClient(on_progress=display, on_status=display.status)`.

    Args:
        stream: where to.
        clock: seconds, for rates.
    """

    def __init__(self, stream=sys.stderr, clock: Callable[[], float] = time.monotonic):
        self._stream, self._bars, self._tasks, self._shown = stream, None, {}, {}
        self.buses = BusCounterTotals(clock)
        self.alerts: list[str] = []

    def __enter__(self) -> "ProgressDisplay":
        if self._stream.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bars
            from rich.table import Column

            # in a narrow terminal the words give way, not the figures
            self._bars = Bars(
                TextColumn("{task.fields[stage]}", table_column=Column(min_width=11)),
                BarColumn(bar_width=None, table_column=Column(min_width=8, max_width=24)),
                TaskProgressColumn(table_column=Column(min_width=4)),
                TimeElapsedColumn(table_column=Column(min_width=7)),
                TextColumn(
                    "{task.description}",
                    markup=False,
                    table_column=Column(no_wrap=True, overflow="ellipsis"),
                ),
                console=Console(file=self._stream),
            )
            self._bars.start()
        return self

    def __exit__(self, *_):
        if self._bars is not None:
            self._bars.stop()

    def say(self, text: str, style: str | None = None) -> None:
        """Write a line of its own; a style, as of rich, is for terminals."""
        if self._bars is None:
            print(text, file=self._stream, flush=True)
        else:
            self._bars.console.print(text, markup=False, highlight=False, style=style)

    def __call__(self, progress: Progress) -> None:
        """Show how far a stage is."""
        if self._bars is not None:
            self._update(progress.stage, progress.fraction, progress.text)
            return
        before = self._shown.get(progress.stage, 1.0)
        begins = progress.fraction < before
        if begins or progress.fraction == 1.0 or progress.fraction >= before + _LINE_EVERY:
            self._shown[progress.stage] = progress.fraction
            self.say(f"{progress.stage:<12} {100 * progress.fraction:3.0f} %  {progress.text}")

    def status(self, status: Status, before: Status | None) -> None:
        """Show what the buses carry; tell of anything that gets worse, once."""
        if self.buses.hear(status) and self._bars is not None:
            self._update("buses", None, str(self.buses))
        worse = status.level > (Level.OK if before is None else before.level)
        if worse and status.level is not Level.STALE:
            self.alerts.append(f"{status.name}: {status.text}")
            style = "bold red" if status.level is Level.ERROR else "yellow"
            self.say(f"{status.level.name:<12}        {self.alerts[-1]}", style)

    def _update(self, stage, fraction, text):
        if stage not in self._tasks:
            total = None if fraction is None else 1.0
            self._tasks[stage] = self._bars.add_task("", total=total, stage=stage)
        task = self._tasks[stage]
        if fraction is not None and fraction < self._bars.tasks[task].completed:
            self._bars.reset(task)  # the stage is at work on another plan
        self._bars.update(task, completed=fraction, description=text)


def table(rows) -> str:
    """Return rows of cells as lines, columns aligned, numbers to the right."""
    rows = [[str(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*rows)]
    lines = []
    for row in rows:
        cells = [
            cell.rjust(width) if cell[:1].isdigit() or cell[:1] == "-" else cell.ljust(width)
            for cell, width in zip(row, widths)
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)
