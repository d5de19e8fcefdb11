# SPDX-License-Identifier: Apache-2.0
"""The stamp that names a plan, and the frame of every message."""

from dataclasses import dataclass
from typing import Protocol

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from fiber_msgs_py.errors import MessageError

__all__ = [
    "FRAME_ID",
    "PlanStamp",
    "Stamped",
    "check_frame",
    "header",
    "ns_from_time",
    "time_from_ns",
]

FRAME_ID = "focal_plane"

_SECOND = 1_000_000_000
_END_NS = 2**31 * _SECOND


class Stamped(Protocol):
    """Any message with a header."""

    @property
    def header(self) -> Header:
        """The header: stamp and frame."""
        ...


def ns_from_time(time: Time) -> int:
    """Return a time as nanoseconds.

    Raises:
        MessageError: the time is negative, or its nanoseconds are a second or more.
    """
    if time.sec < 0 or not 0 <= time.nanosec < _SECOND:
        raise MessageError(
            "time", "is not a valid time", field="stamp", value=(time.sec, time.nanosec)
        )
    return time.sec * _SECOND + time.nanosec


def time_from_ns(ns: int) -> Time:
    """Return nanoseconds as a time.

    Raises:
        MessageError: the number is negative, or past the last second that a message can hold.
    """
    ns = int(ns)
    if not PlanStamp.fits(ns):
        raise MessageError("time", "does not fit a stamp", field="ns", value=ns)
    return Time(sec=ns // _SECOND, nanosec=ns % _SECOND)


@dataclass(frozen=True, order=True)
class PlanStamp:
    """Names a plan, or a later attempt of a plan, by the header stamp of its targets.

    All messages derived from these targets carry the stamp unchanged. Stamps are ordered: of two
    plans the one with the larger stamp is newer, and the stamp of a later attempt lies between
    that of its plan and that of the next plan.

    Args:
        ns: the stamp [ns].

    Raises:
        MessageError: the number does not fit a header stamp.
    """

    ns: int

    def __post_init__(self):
        time_from_ns(self.ns)

    @classmethod
    def of(cls, message: Stamped) -> "PlanStamp":
        """Return the stamp of any message with a header.

        Raises:
            MessageError: the stamp is negative, or its nanoseconds are a second or more.
        """
        return cls(ns_from_time(message.header.stamp))

    @staticmethod
    def fits(ns: int) -> bool:
        """Return whether a number of nanoseconds fits a header stamp."""
        return 0 <= ns < _END_NS

    def to_time(self) -> Time:
        """Return the stamp as a message."""
        return time_from_ns(self.ns)

    def __str__(self) -> str:
        return f"{self.ns // _SECOND}.{self.ns % _SECOND:09d}"


def header(stamp: PlanStamp) -> Header:
    """Return the header of a message that belongs to a plan."""
    return Header(stamp=stamp.to_time(), frame_id=FRAME_ID)


def check_frame(message: Stamped, name: str) -> None:
    """Refuse a message in another frame than `focal_plane`, of any namespace.

    Args:
        message: any message with a header.
        name: name of the message in the error.

    Raises:
        MessageError: the frame is another; names it.
    """
    frame_id = message.header.frame_id
    if frame_id.startswith("/") or frame_id.rpartition("/")[2] != FRAME_ID:
        raise MessageError(name, f"is not {FRAME_ID!r}", field="frame_id", value=repr(frame_id))
