# SPDX-License-Identifier: Apache-2.0
"""The note that a stop was asked for, which outlives a bridge that dies before it can save."""

import threading
from collections.abc import Callable
from pathlib import Path

__all__ = ["StopNote"]

_FIRST_S = 5e-3  # for which STOP waits for the note
_LAST_S = 0.5  # for which its writing is waited for once STOP is sent, and before it is removed
_NOT_NOTED = "the stop is not noted beside the memory of the robots"
_LEFT = (
    "if the bridge dies before it has saved its memory, the next bridge takes the stop for its "
    "own, and clears it"
)


class StopNote:
    """An empty file beside the memory of the robots, from a stop until the memory tells of it.

    It takes some 0.05 ms to make, and outlives this process, but not a loss of power of the
    computer. A disk may be slow, so that a thread makes it: STOP goes out after 5 ms at the latest.

    Args:
        memory: file of the memory; None for no memory and no note.
        warn: called with what goes wrong.
    """

    def __init__(self, memory: Path | None, warn: Callable[[str], None]):
        self._path = None if memory is None else memory.with_name(memory.name + ".stop")
        self._warn = warn
        self._writing: threading.Thread | None = None
        self._error: OSError | None = None

    @property
    def found(self) -> bool:
        """Whether there is a note."""
        return self._path is not None and self._path.exists()

    def begin(self) -> None:
        """Begin to write the note, before STOP is sent; return within 5 ms."""
        if self._path is None:
            return
        if self._writing is None or not self._writing.is_alive():
            self._error = None
            self._writing = threading.Thread(
                target=self._write, args=[self._path], name="stop note", daemon=True
            )
            self._writing.start()
        self._writing.join(_FIRST_S)

    def _write(self, path: Path) -> None:
        try:
            path.touch(0o600)
        except OSError as error:
            self._error = error

    def finish(self) -> None:
        """Tell what is left if the note is not written, after STOP is sent."""
        if self._is_slow():
            self._warn(f"{_NOT_NOTED} after {_LAST_S:g} s: {_LEFT}")
        elif self._error is not None:
            self._warn(f"{_NOT_NOTED}: {self._error}: {_LEFT}")

    def remove(self) -> None:
        """Remove the note: the memory tells of the stop, or the robots were cleared since."""
        if self._path is None:
            return
        try:
            if self._is_slow():
                raise TimeoutError(f"it is not written after {_LAST_S:g} s")
            self._path.unlink(missing_ok=True)
        except OSError as error:
            self._warn(f"the note of a stop beside the memory of the robots stays: {error}")

    def _is_slow(self) -> bool:
        if self._writing is not None:
            self._writing.join(_LAST_S)
        return self._writing is not None and self._writing.is_alive()
