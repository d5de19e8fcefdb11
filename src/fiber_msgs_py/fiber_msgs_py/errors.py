"""Errors of the message border."""

from fiber_core.errors import FiberError

__all__ = ["MessageError"]


class MessageError(FiberError):
    """A message is malformed, or a value does not fit the message it should travel in.

    Args:
        message: which message, as the topic is called.
        problem: what is wrong, in words that follow the value.
        field: field or array concerned.
        robot: id of the robot concerned.
        value: the offending value.
    """

    def __init__(self, message: str, problem: str, *, field=None, robot=None, value=None):
        self.message, self.field, self.robot, self.value = message, field, robot, value
        parts = [message]
        if robot is not None:
            parts.append(f"robot {robot}")
        said = problem if value is None else f"{value} {problem}"
        parts.append(said if field is None else f"{field} {said}")
        super().__init__(": ".join(parts))
