# SPDX-License-Identifier: Apache-2.0
"""The memory of the robots in a file, which outlives a plant that is killed."""

import fcntl
import hashlib
import mmap
import os
from pathlib import Path

import numpy as np

from fiber_bus_bridge.plant.messages import PlantError
from fiber_bus_bridge.simulation import SimulatedBuses

__all__ = ["MemoryFile"]

_AFTER_S = 1e-6
_HEAD = np.dtype([("digest", "S32"), ("now_s", "<f8"), ("unused", "S24")])


class MemoryFile:
    """Keeps the memory of a plant's robots in a file that is mapped into the process.

    Every change of a robot is in the file at once, because it is the memory of the robot. A plant
    that begins with the file of an earlier one takes over its robots: all of them had a power
    cut, so they are where they were and have booted once more.

    Args:
        path: the file; it is made where it is missing.
        buses: the buses and robots, before their first message.

    Raises:
        PlantError: the file cannot be used, or another plant uses it.
    """

    def __init__(self, path: Path, buses: SimulatedBuses):
        self._buses, robots = buses, buses.positioners
        size = _HEAD.itemsize + robots.memory.nbytes
        try:
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise PlantError(f"the memory file {path} cannot be used: {error}") from error
        constant = robots.memory[["address", "ten_bit", "serial", "quantum_prad", "coupling"]]
        digest = hashlib.sha256(repr(robots.memory.dtype).encode() + constant.tobytes()).digest()
        # a digest that ends with a zero byte would be cut there
        digest = digest[:31] + b"."
        fits = os.fstat(self._file).st_size == size
        os.ftruncate(self._file, size)
        mapped = mmap.mmap(self._file, size)
        self._head = np.frombuffer(mapped, _HEAD, 1)
        memory = np.frombuffer(mapped, robots.memory.dtype, offset=_HEAD.itemsize)
        self.taken_over = fits and self._head["digest"][0] == digest
        if not self.taken_over:
            memory[:] = robots.memory
            self._head["digest"], self._head["now_s"] = digest, 0.0
        robots.memory = memory

    def power_cut(self) -> None:
        """Let robots that were taken over lose their power at the time of the file, and boot."""
        if self.taken_over:
            robots = self._buses.positioners
            # after the last heartbeat, which came before the time was written
            heard_s = float(robots.memory["heartbeat_s"].max(initial=0.0))
            now_s = max(float(self._head["now_s"][0]), heard_s) + _AFTER_S
            self._buses.run_until(now_s)
            rows = np.flatnonzero(robots.powered)
            robots.power(rows, False, now_s)
            robots.power(rows, True, now_s)

    def keep_time(self) -> None:
        """Write the present time of the buses into the file."""
        self._head["now_s"] = self._buses.now_s
