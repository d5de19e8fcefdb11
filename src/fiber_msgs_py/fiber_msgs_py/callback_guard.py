# SPDX-License-Identifier: Apache-2.0
"""A guard round the callbacks of a node: an unexpected exception is reported, the node lives on.

A message may come from any program, and one that no decoder was made for must not end a node that
moves robots. `Topic.subscription` and `Service.server` put the guard round every callback. Errors
that a callback expects, such as a MessageError, it handles itself. What fails after the context of
the node was shut down is no fault, and is not reported.
"""

import traceback
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

from fiber_msgs_py.rate_limit import RateLimit

__all__ = ["guarded", "guarded_service", "report_failures_to", "take_failures"]

_KEPT = 100

_Report = Callable[[str], None]

_reports: WeakKeyDictionary[Any, _Report] = WeakKeyDictionary()
_failures: deque[Exception] = deque(maxlen=_KEPT)
_limit = RateLimit()


def guarded(node: Any, name: str, callback: Callable[..., object]) -> Callable[..., None]:
    """Return a callback that reports an exception instead of raising it.

    Args:
        node: the node of the callback, an rclpy Node.
        name: name of the callback in the report, such as that of its topic.
        callback: the callback, of a subscription with one argument or of a timer with none.
    """

    def call(*arguments: object) -> None:
        try:
            callback(*arguments)
        except Exception as error:
            _report(node, name, error)

    return call


def guarded_service(
    node: Any, name: str, callback: Callable[[Any, Any], Any]
) -> Callable[[Any, Any], Any]:
    """Return the callback of a service that answers an exception with a failure.

    Args:
        node: the node of the service.
        name: name of the service.
        callback: the callback, of a service with `success` and `message` in its answer.
    """

    def serve(request: Any, response: Any) -> Any:
        try:
            return callback(request, response)
        except Exception as error:
            response.success, response.message = False, _report(node, name, error)
            return response

    return serve


def _report(node: Any, name: str, error: Exception) -> str:
    if not node.context.ok():  # after a signal whatever a callback asks of the graph fails
        return f"{name}: the node ends"
    _failures.append(error)
    place = traceback.extract_tb(error.__traceback__)[-1]
    text = (
        f"{name}: unexpected {type(error).__name__}: {error} "
        f"({Path(place.filename).name}, line {place.lineno})"
    )
    line = _limit.line(f"{id(node)} {name}", text)
    if line is not None:
        trace = "".join(traceback.format_exception(error))
        node.get_logger().error(f"{line}; the node goes on. Please report this fault:\n{trace}")
        report = _reports.get(node)
        if report is not None:
            report(text)
    return text


def report_failures_to(node: Any, report: _Report) -> None:
    """Report the failures of a node's callbacks to a function, beside the log.

    Args:
        node: the node.
        report: called with the text of a failure, at most once a second for each callback.
    """
    _reports[node] = report


def take_failures() -> list[Exception]:
    """Return and forget the last hundred exceptions in callbacks of this process, for tests."""
    taken = list(_failures)
    _failures.clear()
    return taken
