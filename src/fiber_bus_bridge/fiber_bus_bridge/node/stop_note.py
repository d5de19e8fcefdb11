# SPDX-License-Identifier: Apache-2.0
"""The note that a stop was asked for, which outlives a bridge that dies before it can save."""

import threading
import weakref
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from typing import TypeAlias

__all__ = ["StopNote"]

_FIRST_S = 5e-3  # for which STOP waits for the note
_LAST_S = 0.5  # for which its writing is waited for once STOP is sent, and before it is removed
_NOT_NOTED = "the stop is not noted beside the memory of the robots"
_LEFT = (
    "if the bridge dies before it has saved its memory, the next bridge takes the stop for its "
    "own, and clears it"
)

_Job: TypeAlias = "tuple[Path, _Writing] | None"


class _Writing:
    # one note that is written

    def __init__(self) -> None:
        self.ended = threading.Event()
        self.error: OSError | None = None


def _write_all(jobs: "SimpleQueue[_Job]") -> None:
    while (job := jobs.get()) is not None:
        path, writing = job
        try:
            path.touch(0o600)
        except OSError as error:
            writing.error = error
        writing.ended.set()


class StopNote:
    """An empty file beside the memory of the robots, from a stop until the memory tells of it.

    It takes some 0.05 ms to make, and outlives this process, but not a loss of power of the
    computer. A disk may be slow, so that a thread makes it: STOP goes out after 5 ms at the latest.
    The thread begins with this object, as the system may have no place for one when a stop comes.

    Args:
        memory: file of the memory; None for no memory and no note.
        warn: called with what goes wrong.
    """

    def __init__(self, memory: Path | None, warn: Callable[[str], None]):
        self._path = None if memory is None else memory.with_name(memory.name + ".stop")
        self._warn = warn
        self._writing: _Writing | None = None
        self._jobs: SimpleQueue[_Job] = SimpleQueue()
        if memory is not None:
            threading.Thread(
                target=_write_all, args=[self._jobs], name="stop note", daemon=True
            ).start()
            weakref.finalize(self, self._jobs.put, None)

    @property
    def found(self) -> bool:
        """Whether there is a note."""
        return self._path is not None and self._path.exists()

    def begin(self) -> None:
        """Begin to write the note, before STOP is sent; return within 5 ms."""
        if self._path is None:
            return
        if self._writing is None or self._writing.ended.is_set():
            self._writing = _Writing()
            self._jobs.put((self._path, self._writing))
        self._writing.ended.wait(_FIRST_S)

    def finish(self) -> None:
        """Tell what is left if the note is not written, after STOP is sent."""
        if self._is_slow():
            self._warn(f"{_NOT_NOTED} after {_LAST_S:g} s: {_LEFT}")
        elif self._writing is not None and self._writing.error is not None:
            self._warn(f"{_NOT_NOTED}: {self._writing.error}: {_LEFT}")

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
        return self._writing is not None and not self._writing.ended.wait(_LAST_S)
