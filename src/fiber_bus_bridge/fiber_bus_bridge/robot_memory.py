# SPDX-License-Identifier: Apache-2.0
"""What must be remembered of robots over a restart of the bridge, and the file that keeps it.

A robot that does not answer stands where it was read last, if it rested then. If it was sent a GO
since, nothing is known but the interval that its joints can reach, and its neighbours rest until it
is read, or an operator vouches for its place. Only a memory on disk tells one from the other after
a restart.

The file is JSON: one list for each column in the order of `ids`, `format`, `plane` (a fingerprint
of ids, buses and addresses), the size of a quantum, and a checksum of all of it.
"""

import hashlib
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from fiber_bus_bridge.checked_file import float_column, int_column, read_checked, write_checked
from fiber_bus_bridge.errors import BridgeError
from fiber_core.array_types import Codes, Counts, Floats, Ints, Mask
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Reason

__all__ = ["RobotMemory", "fingerprint", "load_memory", "plant_name", "save_memory"]

_NAME = "memory of the robots"
_FORMAT = "robot memory of fiber_bus_bridge, 1"
_COLUMNS = ("theta", "phi", "placed", "lost", "boot", "failed")
_TURNS = ("turn_down", "turn_up")
_KNOWN = ("theta_mm", "phi_mm")


@dataclass(frozen=True, eq=False)
class RobotMemory:
    """Robots and buses as they were known last.

    Args:
        counts: joint positions read last, or vouched for [quanta], shape (n, 2).
        placed: whether counts are of a reading, or vouched for, shape (n,).
        lost: whether the robot was sent a GO since, shape (n,).
        boot: boot counter, -1 if it was never read, shape (n,).
        failed: Reason for which the robot is left out of plans, else OK, shape (n,).
        sequence: sequence number of the last orders on each bus, 0 for none, shape (b,).
        stopped: whether all robots were stopped and nothing has cleared them since.
        moving: whether robots move by orders of the controller, so that a STOP found later is its
            own, after a failure, if no other was asked for.
        turn_limit: how far theta may turn down and up while the place of a robot is unknown
            [quanta], shape (n, 2); None where counters are believed, and in files of earlier
            versions: no robot may turn.
        unplaced: robots at unknown places, shape (n,); None in files of earlier versions.
        known_mm: how far points of both outlines may be from where the counters put them, by the
            last image [mm], shape (n, 2); None in files of earlier versions.
    """

    counts: Counts
    placed: Mask
    lost: Mask
    boot: Ints
    failed: Codes
    sequence: Ints
    stopped: bool = False
    moving: bool = False
    turn_limit: Counts | None = None
    unplaced: Mask | None = None
    known_mm: Floats | None = None

    def same(self, other: "RobotMemory") -> bool:
        """Return whether another memory has the same content."""
        return all(
            np.array_equal(getattr(self, name), getattr(other, name))
            for name in (field.name for field in fields(self))
        )


def fingerprint(plane: FocalPlane) -> str:
    """Return a text that differs between planes with other robots, buses or addresses."""
    columns = np.stack([plane.ids, plane.bus, plane.address]).astype("<i8")
    return hashlib.sha256(columns.tobytes() + plane.centers.astype("<f8").tobytes()).hexdigest()[
        :16
    ]


def save_memory(
    path: Path, memory: RobotMemory, plane: FocalPlane, quantum_prad: int, plant: str = ""
) -> None:
    """Replace the file as a whole, on disk before the call returns.

    Args:
        path: the file; missing folders are created.
        memory: the memory.
        plane: the focal plane.
        quantum_prad: one quantum [1e-12 rad].
        plant: names the process of simulated robots, as from `plant_name`; empty for none.

    Raises:
        BridgeError: the file cannot be written.
    """
    content: dict[str, object] = {
        "format": _FORMAT,
        "plane": fingerprint(plane),
        "quantum_prad": quantum_prad,
        "plant": plant,
        "ids": plane.ids.tolist(),
        "theta": memory.counts[:, 0].tolist(),
        "phi": memory.counts[:, 1].tolist(),
        "placed": memory.placed.astype(int).tolist(),
        "lost": memory.lost.astype(int).tolist(),
        "boot": memory.boot.tolist(),
        "failed": memory.failed.tolist(),
        "sequence": memory.sequence.tolist(),
        "stopped": int(memory.stopped),
        "moving": int(memory.moving),
    }
    if memory.turn_limit is not None:
        for name, column in zip(_TURNS, memory.turn_limit.T, strict=True):
            content[name] = column.tolist()
    if memory.unplaced is not None:
        content["unplaced"] = memory.unplaced.astype(int).tolist()
    if memory.known_mm is not None:
        for name, known_mm in zip(_KNOWN, memory.known_mm.T, strict=True):
            content[name] = known_mm.tolist()
    write_checked(path, content, _NAME)


def plant_name(socket: Path | None) -> str:
    """Return a name of the process that listens at a socket, whatever clocks say; "" for none.

    Raises:
        OSError: the socket is not there.
    """
    if socket is None:
        return ""
    made = socket.stat()
    return f"{made.st_ino}-{made.st_mtime_ns}"


def load_memory(
    path: Path, plane: FocalPlane, quantum_prad: int, buses: int, plant: str = ""
) -> RobotMemory | None:
    """Return the memory in a file, None if there is no file, or it is of another plant.

    Args:
        path: the file.
        plane: the focal plane.
        quantum_prad: one quantum [1e-12 rad].
        buses: number of buses.
        plant: as for save_memory.

    Raises:
        BridgeError: the file is damaged, or of another plane; names what is wrong.
    """
    try:
        content = read_checked(path, _FORMAT)
        if content is None or content.get("plant", "") != plant:
            return None
        return _memory(content, plane, quantum_prad, buses)
    except BridgeError as error:
        raise BridgeError(f"{_NAME} {path}: {error}") from error


def _memory(
    content: dict[str, object], plane: FocalPlane, quantum_prad: int, buses: int
) -> RobotMemory:
    for name, expected in (
        ("plane", fingerprint(plane)),
        ("quantum_prad", quantum_prad),
        ("ids", plane.ids.tolist()),
    ):
        if content.get(name) != expected:
            raise BridgeError(f"{name} differs: it is of another plane")
    theta, phi, placed, lost, boot, failed = (
        int_column(content, name, plane.n) for name in _COLUMNS
    )
    if not np.isin(failed, [int(reason) for reason in Reason]).all():
        raise BridgeError("failed holds a number that is no reason")
    return RobotMemory(
        np.stack([theta, phi], axis=1),
        placed.astype(bool),
        lost.astype(bool),
        boot,
        failed,
        int_column(content, "sequence", buses),
        _flag(content, "stopped"),
        _flag(content, "moving"),
        _turn_limit(content, plane.n),
        int_column(content, "unplaced", plane.n).astype(bool) if "unplaced" in content else None,
        _known_mm(content, plane.n),
    )


def _turn_limit(content: dict[str, object], n: int) -> Counts | None:
    if not any(name in content for name in _TURNS):
        return None
    limit = np.stack([int_column(content, name, n) for name in _TURNS], axis=1)
    if (limit < 0).any():
        raise BridgeError("turn_down or turn_up holds a number below 0")
    return limit


def _known_mm(content: dict[str, object], n: int) -> Floats | None:
    if not any(name in content for name in _KNOWN):
        return None
    known_mm = np.stack([float_column(content, name, n) for name in _KNOWN], axis=1)
    if not (known_mm >= 0.0).all():
        raise BridgeError("theta_mm or phi_mm holds no length")
    return known_mm


def _flag(content: dict[str, object], name: str) -> bool:
    value = content.get(name, 0)  # files of earlier versions do not say
    if type(value) is not int or value not in (0, 1):
        raise BridgeError(f"{name} is {value!r}, expected 0 or 1")
    return bool(value)
