"""Progress: how far a stage is with a plan.

A DiagnosticStatus: stock tools show it as it is, its pairs carry fraction and plan as
named values, and nothing has to be parsed out of a sentence.
"""

import math
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticStatus

from fiber_msgs_py.diagnostics import Level, Status
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.stamps import PlanStamp

__all__ = ["Progress", "decode", "encode"]


@dataclass(frozen=True)
class Progress:
    """How far a stage is.

    Args:
        stage: who is at work, such as "planner".
        fraction: done so far, 0..1.
        text: one line for people.
        stamp: plan it is about.

    Raises:
        MessageError: the fraction is not within 0..1.
    """

    stage: str
    fraction: float
    text: str
    stamp: PlanStamp

    def __post_init__(self):
        if not (math.isfinite(self.fraction) and 0 <= self.fraction <= 1):
            raise MessageError("progress", "is outside 0..1", field="fraction", value=self.fraction)


def encode(progress: Progress) -> DiagnosticStatus:
    """Return progress as a message."""
    values = {
        "fraction": repr(float(progress.fraction)),
        "plan_ns": progress.stamp.ns,
        "attempt": progress.stamp.attempt,
    }
    return Status(progress.stage, Level.OK, progress.text, values).to_message()


def decode(message: DiagnosticStatus) -> Progress:
    """Return the progress a message tells of.

    Raises:
        MessageError: a value is missing or is no number in its range.
    """
    values = {pair.key: pair.value for pair in message.values}
    numbers = []
    for key, kind in (("fraction", float), ("plan_ns", int), ("attempt", int)):
        if key not in values:
            raise MessageError("progress", "is missing", field="value", value=key)
        try:
            numbers.append(kind(values[key]))
        except ValueError:
            raise MessageError(
                "progress", "is no number", field=key, value=repr(values[key])
            ) from None
    return Progress(message.name, numbers[0], message.message, PlanStamp(*numbers[1:]))
