"""Diagnostics: counters and alerts of a node or a bus, for any ROS tool."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.stamps import PlanStamp, header

__all__ = ["Level", "Status", "decode", "encode"]

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
        hardware_id: name of the hardware, empty for software.
    """

    name: str
    level: Level
    text: str
    values: Mapping[str, object] = field(default_factory=dict)
    hardware_id: str = ""

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
