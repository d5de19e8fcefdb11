"""What a terminal shows: progress of the stages, and tables."""

import sys

from fiber_msgs_py import Progress

__all__ = ["ProgressDisplay", "table"]

_LINE_EVERY = 0.25  # of a stage's work, where there are no bars


class ProgressDisplay:
    """Shows the progress of every stage: bars in a terminal, a few lines elsewhere.

    Args:
        stream: where to.
    """

    def __init__(self, stream=sys.stderr):
        self._stream, self._bars, self._tasks, self._shown = stream, None, {}, {}

    def __enter__(self) -> "ProgressDisplay":
        if self._stream.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, TaskProgressColumn, TextColumn
            from rich.progress import Progress as Bars

            self._bars = Bars(
                TextColumn("{task.fields[stage]:<12}"),
                BarColumn(),
                TaskProgressColumn(),
                TextColumn("{task.description}", markup=False),
                console=Console(file=self._stream),
            )
            self._bars.start()
        return self

    def __exit__(self, *_):
        if self._bars is not None:
            self._bars.stop()

    def say(self, text: str) -> None:
        """Write a line of its own."""
        if self._bars is None:
            print(text, file=self._stream, flush=True)
        else:
            self._bars.console.print(text, markup=False, highlight=False)

    def __call__(self, progress: Progress) -> None:
        """Show how far a stage is."""
        if self._bars is not None:
            stage = progress.stage
            if stage not in self._tasks:
                self._tasks[stage] = self._bars.add_task("", total=1.0, stage=stage)
            self._bars.update(
                self._tasks[stage], completed=progress.fraction, description=progress.text
            )
            return
        before = self._shown.get(progress.stage, 1.0)
        begins = progress.fraction < before
        if begins or progress.fraction == 1.0 or progress.fraction >= before + _LINE_EVERY:
            self._shown[progress.stage] = progress.fraction
            self.say(f"{progress.stage:<12} {100 * progress.fraction:3.0f} %  {progress.text}")


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
