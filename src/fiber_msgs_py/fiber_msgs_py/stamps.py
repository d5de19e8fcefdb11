"""The stamp that names a plan, and the frame every message is in."""

import re
from dataclasses import dataclass

from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from fiber_msgs_py.errors import MessageError

__all__ = ["FRAME_ID", "PlanStamp", "check_frame", "header", "ns_from_time", "time_from_ns"]

FRAME_ID = "focal_plane"

_LATER = re.compile(FRAME_ID + r"/attempt_([1-9]\d{0,8})")  # frame of a later attempt

_SECOND = 1_000_000_000
_END_NS = 2**31 * _SECOND


def ns_from_time(time: Time) -> int:
    """Return a time as nanoseconds.

    Raises:
        MessageError: it is negative, or holds a second or more of nanoseconds.
    """
    if time.sec < 0 or not 0 <= time.nanosec < _SECOND:
        raise MessageError("time", "is no time", field="stamp", value=(time.sec, time.nanosec))
    return time.sec * _SECOND + time.nanosec


def time_from_ns(ns: int) -> Time:
    """Return nanoseconds as a time.

    Raises:
        MessageError: negative, or past the last second a message can carry.
    """
    ns = int(ns)
    if not 0 <= ns < _END_NS:
        raise MessageError("time", "does not fit a stamp", field="ns", value=ns)
    return Time(sec=ns // _SECOND, nanosec=ns % _SECOND)


@dataclass(frozen=True, order=True)
class PlanStamp:
    """Names a plan: the header stamp of its targets, carried by all that follows from them.

    A plan that is planned again, around robots that could not be commanded, keeps its stamp:
    what belongs to its second attempt is in the frame `focal_plane/attempt_2`, and so on.
    Stamps are ordered: of two plans the one with the larger stamp is newer, and of two attempts
    of a plan the later one.

    Args:
        ns: the stamp [ns].
        attempt: which attempt of the plan, from 1.

    Raises:
        MessageError: the number does not fit a header stamp, or there is no such attempt.
    """

    ns: int
    attempt: int = 1

    def __post_init__(self):
        time_from_ns(self.ns)
        if not 1 <= self.attempt < 10**9:
            raise MessageError("time", "is no attempt", field="attempt", value=self.attempt)

    @classmethod
    def of(cls, message) -> "PlanStamp":
        """Read the stamp of any message with a header; another frame than ours is no attempt."""
        later = _LATER.fullmatch(message.header.frame_id)
        return cls(ns_from_time(message.header.stamp), int(later[1]) if later else 1)

    @property
    def plan(self) -> "PlanStamp":
        """The plan as its targets named it, whatever the attempt."""
        return PlanStamp(self.ns)

    @property
    def next_attempt(self) -> "PlanStamp":
        """The same plan, tried once more."""
        return PlanStamp(self.ns, self.attempt + 1)

    @property
    def frame_id(self) -> str:
        """The frame of its messages, which tells the attempt."""
        return FRAME_ID if self.attempt == 1 else f"{FRAME_ID}/attempt_{self.attempt}"

    def to_time(self) -> Time:
        """Return the stamp as a message."""
        return time_from_ns(self.ns)

    def __str__(self) -> str:
        time = f"{self.ns // _SECOND}.{self.ns % _SECOND:09d}"
        return time if self.attempt == 1 else f"{time} attempt {self.attempt}"


def header(stamp: PlanStamp) -> Header:
    """Return the header of a message that belongs to a plan."""
    return Header(stamp=stamp.to_time(), frame_id=stamp.frame_id)


def check_frame(message, name: str) -> None:
    """Refuse a message in another frame than `focal_plane`; `name` is what to call it.

    The frame of a later attempt of a plan is the same place.
    """
    frame_id = message.header.frame_id
    if frame_id != FRAME_ID and not _LATER.fullmatch(frame_id):
        raise MessageError(name, f"is not {FRAME_ID!r}", field="frame_id", value=repr(frame_id))
