# SPDX-License-Identifier: Apache-2.0
"""Diagnostics: counters and alerts of a node or a bus, for any ROS tool."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.stamps import PlanStamp, header

__all__ = ["Level", "Status", "decode", "encode"]

_HARDWARE = "focal_plane"

_LONGEST_COUNT = 20  # digits


class Level(IntEnum):
    """Severity, with the numbers of DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Status:
    """The state of one node, bus or stage.

    Args:
        name: name of the part, such as "bridge: bus 3".
        level: severity.
        text: one line for people.
        values: values by name.
        hardware_id: name of the hardware; empty for the focal plane.
    """

    name: str
    level: Level
    text: str
    values: Mapping[str, object] = field(default_factory=dict)
    hardware_id: str = ""

    def in_namespace(self, namespace: str) -> "Status":
        """Return the status with the namespace of its node in its name and its hardware_id.

        Two planes share the topic of diagnostics: "north/bridge: bus 3" is of the node in /north.

        Args:
            namespace: the namespace, as Node.get_namespace gives it.
        """
        prefix = f"{namespace.strip('/')}/".lstrip("/")
        hardware = prefix + (self.hardware_id or _HARDWARE)
        return replace(self, name=prefix + self.name, hardware_id=hardware)

    def of_namespace(self, namespace: str) -> "Status | None":
        """Return the status with its name inside a namespace, None if it is of another one."""
        own, _, name = self.name.rpartition("/")
        return replace(self, name=name) if own == namespace.strip("/") else None

    def count(self, name: str) -> int:
        """Return a value that counts something; 0 where it is missing or no whole number."""
        text = str(self.values.get(name, 0))
        return int(text) if text.isdecimal() and len(text) < _LONGEST_COUNT else 0

    def to_message(self) -> DiagnosticStatus:
        """Return the status as a message; values are sent as text."""
        return DiagnosticStatus(
            level=bytes([self.level]),
            name=self.name,
            message=self.text,
            hardware_id=self.hardware_id,
            values=[KeyValue(key=key, value=str(value)) for key, value in self.values.items()],
        )

    @classmethod
    def of(cls, message: DiagnosticStatus) -> "Status":
        """Return the status in a message; values are text.

        Raises:
            MessageError: the level is not one of Level.
        """
        level = message.level[0]
        if level not in list(Level):
            raise MessageError("diagnostics", "is unknown", field="level", value=level)
        return cls(
            name=message.name,
            level=Level(level),
            text=message.message,
            values={pair.key: pair.value for pair in message.values},
            hardware_id=message.hardware_id,
        )


def encode(statuses: Iterable[Status], time_ns: int) -> DiagnosticArray:
    """Return statuses as one message.

    Args:
        statuses: the statuses.
        time_ns: time of the statuses [ns].
    """
    return DiagnosticArray(
        header=header(PlanStamp(time_ns)), status=[status.to_message() for status in statuses]
    )


def decode(message: DiagnosticArray) -> list[Status]:
    """Return the statuses of a message.

    Raises:
        MessageError: a level is not one of Level.
    """
    return [Status.of(status) for status in message.status]
