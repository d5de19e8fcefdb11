# SPDX-License-Identifier: Apache-2.0
"""The memory of the robots on disk: recalled when the bridge starts, saved before it is needed."""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from fiber_bus_bridge.availability import Availability
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.node.hardware import Hardware
from fiber_bus_bridge.node.stop_note import StopNote
from fiber_bus_bridge.robot_memory import (
    RobotMemory,
    fingerprint,
    load_memory,
    plant_name,
    save_memory,
)
from fiber_bus_bridge.session import Session

__all__ = ["MemoryConfig", "Remembered", "memory_path"]


@dataclass(frozen=True)
class MemoryConfig:
    """Where the bridge remembers its robots over a restart.

    Args:
        memory: file with places, failures and sequence numbers of the robots; "auto" for one of
            this user and plane, where the robots outlive the bridge; "none" for no file: robots at
            unknown places that outlive the bridge then do not turn.
    """

    memory: str = "auto"


def memory_path(config: MemoryConfig, hardware: Hardware) -> Path | None:
    """Return the file of the memory, None for none.

    The default of robots in a plant is beside its socket, that of robots on I2C adapters in
    XDG_STATE_HOME, or ~/.local/state without one, with the fingerprint of the plane in its name.
    """
    if config.memory == "none":
        return None
    if config.memory != "auto":
        return Path(config.memory)
    if not hardware.robots_outlive:
        return None
    if hardware.plant is not None:
        return hardware.plant.with_name(hardware.plant.name + ".robots.json")
    base = os.environ.get("XDG_STATE_HOME")
    folder = Path(base) if base else Path.home() / ".local" / "state"
    return folder / "fiber_positioners" / f"robots-{fingerprint(hardware.plane)}.json"


class Remembered:
    """Keeps the memory of the robots of a session in a file, and notes stops beside it.

    Args:
        session: the session, not configured yet.
        availability: the robots that failed, which are recalled too.
        hardware: the hardware of the robots.
        path: the file; None for no memory.
        warn: called with what is wrong with the file.
    """

    def __init__(
        self,
        session: Session,
        availability: Availability,
        hardware: Hardware,
        path: Path | None,
        warn: Callable[[str], None],
    ):
        self._session, self._availability, self._path = session, availability, path
        self._saved: RobotMemory | None = None
        self._warn = warn
        self.stop_note = StopNote(path, warn)
        session.protocol.save = self.save
        self._plant = ""
        if path is None:
            if hardware.robots_outlive:
                self._forget_turns("memory is none, and turns of earlier bridges are not known")
            return
        memory = self._load(path, hardware, warn)
        if memory is not None:
            if self.stop_note.found:
                memory = replace(memory, stopped=True, moving=False)
            session.recall(memory)
            availability.failed = memory.failed.copy()

    def _load(
        self, path: Path, hardware: Hardware, warn: Callable[[str], None]
    ) -> RobotMemory | None:
        session = self._session
        try:
            self._plant = plant_name(hardware.plant)
            quantum, buses = session.units.quantum_prad, len(session.buses)
            memory = load_memory(path, hardware.plane, quantum, buses, self._plant)
            if memory is None and path.exists():  # of the robots of an earlier plant
                self._forget_turns(f"{path} is of another plant; remove it if robots are others")
            return memory
        except (BridgeError, OSError) as error:
            warn(
                f"{error}; no robot that does not answer is believed to be where it was, and its "
                "neighbours rest until it is read or vouched for; robots at unknown places do not "
                "turn, as earlier turns may have used up half of their gaps"
            )
            session.forget_turns()
            return None

    def _forget_turns(self, why: str) -> None:
        if not self._session.config.counters_kept:
            self._session.forget_turns()
            self._warn(f"robots at unknown places do not turn: {why}")

    def save_or_warn(self) -> None:
        """Save what has changed; tell when the file cannot be written."""
        try:
            self.save()
        except BridgeError as error:
            self._warn(str(error))

    def save(self, starting: bool = False) -> None:
        """Save what has changed.

        Args:
            starting: whether the verified robots are about to be sent a GO.

        Raises:
            BridgeError: the file cannot be written.
        """
        if self._path is None:
            return
        memory = self._session.memory(self._availability.failed, starting)
        if self._saved is None or not memory.same(self._saved):
            quantum = self._session.units.quantum_prad
            save_memory(self._path, memory, self._session.plane, quantum, self._plant)
            self._saved = memory
        if not memory.moving:
            self.stop_note.remove()
