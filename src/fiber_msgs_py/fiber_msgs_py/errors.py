# SPDX-License-Identifier: Apache-2.0
"""Errors in messages."""

from fiber_core.errors import FiberError

__all__ = ["MessageError"]


class MessageError(FiberError):
    """A message is malformed, or a value does not fit its message.

    The text is "message: robot 7: field value problem", without the parts that are not given.

    Args:
        message: name of the message, that of its topic.
        problem: the problem, in words that follow the value.
        field: field or array concerned.
        robot: id of the robot concerned.
        value: the offending value.
    """

    def __init__(
        self,
        message: str,
        problem: str,
        *,
        field: str | None = None,
        robot: int | None = None,
        value: object = None,
    ):
        self.message, self.field, self.robot, self.value = message, field, robot, value
        parts = [message]
        if robot is not None:
            parts.append(f"robot {robot}")
        text = problem if value is None else f"{value} {problem}"
        parts.append(text if field is None else f"{field} {text}")
        super().__init__(": ".join(parts))
