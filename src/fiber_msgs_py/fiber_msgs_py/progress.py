# SPDX-License-Identifier: Apache-2.0
"""Progress: how far a stage is with an attempt of a plan.

A DiagnosticStatus: stock tools show it as it is. Its values are named: the fraction done, the
stamp of the attempt [ns], the stamp of the plan [ns], the number of the attempt, and, where the
bridge says so, the times of the oldest layout and joint states it may be planned with [ns]. The
level ERROR says that the stage refuses the attempt.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

from diagnostic_msgs.msg import DiagnosticStatus

from fiber_msgs_py.attempts import Attempt
from fiber_msgs_py.diagnostics import Level, Status
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.sessions import checked_session, session_of
from fiber_msgs_py.stamps import PlanStamp

__all__ = ["Progress", "decode", "encode"]

_Kind = TypeVar("_Kind", int, float)


@dataclass(frozen=True)
class Progress:
    """How far a stage is.

    Args:
        stage: name of the stage, such as "planner".
        fraction: the part of the work that is done, 0..1.
        text: one line for people.
        attempt: the attempt that the stage works on.
        session: id of the session of the attempt, None for no session.
        refused: whether the stage refuses the attempt; the text is its reason.

    Raises:
        MessageError: the fraction is not within 0..1.
    """

    stage: str
    fraction: float
    text: str
    attempt: Attempt
    session: str | None = None
    refused: bool = False

    def __post_init__(self):
        if not (math.isfinite(self.fraction) and 0 <= self.fraction <= 1):
            raise MessageError("progress", "is outside 0..1", field="fraction", value=self.fraction)


def encode(progress: Progress) -> DiagnosticStatus:
    """Return progress as a message."""
    attempt = progress.attempt
    values: dict[str, object] = {
        "fraction": repr(float(progress.fraction)),
        "stamp_ns": attempt.stamp.ns,
        "plan_ns": attempt.plan.ns,
        "attempt": attempt.number,
    }
    if attempt.since_ns is not None:
        values["since_ns"] = attempt.since_ns
    if attempt.layout_ns is not None:
        values["layout_ns"] = attempt.layout_ns
    if progress.session is not None:
        values[checked_session(progress.session)] = "session"
    level = Level.ERROR if progress.refused else Level.OK
    return Status(progress.stage, level, progress.text, values).to_message()


def decode(message: DiagnosticStatus) -> Progress:
    """Return the progress in a message.

    Raises:
        MessageError: a value is missing, is not a number in its range, or the stamps do not fit an
            attempt of a plan.
    """
    values = {pair.key: pair.value for pair in message.values}
    fraction = _number(values, "fraction", float)
    stamp, plan = (PlanStamp(_number(values, f"{name}_ns", int)) for name in ("stamp", "plan"))
    since_ns, layout_ns = (
        _number(values, name, int) if name in values else None for name in ("since_ns", "layout_ns")
    )
    attempt = Attempt(stamp, plan, _number(values, "attempt", int), since_ns, layout_ns)
    refused = message.level == bytes([Level.ERROR])
    session = session_of(message)
    return Progress(message.name, fraction, message.message, attempt, session, refused)


def _number(values: Mapping[str, str], key: str, kind: type[_Kind]) -> _Kind:
    if key not in values:
        raise MessageError("progress", "is missing", field="value", value=key)
    try:
        return kind(values[key])
    except ValueError:
        raise MessageError(
            "progress", "is not a number", field=key, value=repr(values[key])
        ) from None
