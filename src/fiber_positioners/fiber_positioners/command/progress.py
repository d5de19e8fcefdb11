# SPDX-License-Identifier: Apache-2.0
"""Progress on stderr: a bar in a terminal, plain lines elsewhere."""

import sys
from typing import TextIO

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

__all__ = ["ProgressLine"]

_LINE_EVERY = 0.25  # of the work, where there is no bar


class ProgressLine:
    """Shows the progress of one piece of work; call it with a fraction and a text.

    Args:
        stream: the stream that progress is written to.
        every: part of the work between two plain lines, where the stream is no terminal.
    """

    def __init__(self, stream: TextIO | None = None, every: float = _LINE_EVERY):
        self._stream, self._every = stream or sys.stderr, every
        self._shown = -1.0
        self._bar: Progress | None = None

    def __enter__(self) -> "ProgressLine":
        if self._stream.isatty():
            self._bar = Progress(
                BarColumn(),
                TaskProgressColumn(),
                TimeElapsedColumn(),
                TextColumn("{task.description}", markup=False),
                console=Console(file=self._stream),
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task("", total=1.0)
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def __call__(self, fraction: float, text: str) -> None:
        """Show how much of the work is done, 0..1, and a short text."""
        if self._bar is not None:
            self._bar.update(self._task, completed=fraction, description=text)
        elif fraction >= self._shown + self._every or fraction == 1.0 > self._shown:
            self._shown = fraction
            self.line(f"{100 * fraction:3.0f} %  {text}")

    def line(self, text: str) -> None:
        """Write a line of its own."""
        if self._bar is not None:
            self._bar.console.print(text, markup=False, highlight=False)
        else:
            print(text, file=self._stream, flush=True)
