# SPDX-License-Identifier: Apache-2.0
"""Take robots out of use and put them back: the list of disabled robots of the bus bridge."""

import argparse
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from rclpy.parameter import Parameter
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from fiber_client.client import PlaneClient
from fiber_client.errors import PlaneError, PlaneRefusal
from fiber_client.terminal import table
from fiber_core.errors import FiberError
from fiber_node.ros_environment import use_loopback

__all__ = ["DisabledRobots", "disable", "enable"]

_BRIDGE = "bridge"
_LEFT_OUT, _FURTHER = "bridge: left out", "further"
_ABOUT = """
Disabled robots are obstacles where they stand, and end every plan as held, with reason disabled.
The bridge keeps the list over restarts in the file of its parameter disabled_file, if that is
set. While robots move the list stays as it is. Exit code 0: the list is now as requested.
"""

_Change = Callable[[set[int], argparse.Namespace], tuple[set[int], str]]


class DisabledRobots:
    """The list of disabled robots that the bridge keeps, read and written from outside.

    Args:
        client: a client of the graph.
        timeout_s: time-out of each answer [s].
    """

    def __init__(self, client: PlaneClient, timeout_s: float):
        self._client, self._timeout_s = client, timeout_s

    def read(self) -> list[int]:
        """Return the ids of the disabled robots.

        Raises:
            WaitError: there is no bridge, or it does not answer.
        """
        parameters = self._client.bridge_parameters(self._timeout_s)
        answer = self._call(lambda: parameters.get_parameters(["disabled"]))
        return list(answer.values[0].integer_array_value) if answer.values else []

    def write(self, ids: Iterable[int], why: str = "") -> None:
        """Replace the list.

        Args:
            ids: ids of all robots that are to be disabled.
            why: the reason, kept for the robots that are new on the list.

        Raises:
            PlaneRefusal: the bridge refused, with robot and reason.
            WaitError: there is no bridge, or it does not answer.
        """
        new = [
            Parameter("disabled_why", Parameter.Type.STRING, why),
            Parameter("disabled", Parameter.Type.INTEGER_ARRAY, sorted(ids)),
        ]
        parameters = self._client.bridge_parameters(self._timeout_s)
        answer = self._call(lambda: parameters.set_parameters_atomically(new))
        if not answer.result.successful:
            raise PlaneRefusal(_BRIDGE, answer.result.reason)

    def reasons(self) -> dict[int, str]:
        """Return why robots are left out of plans, robots that failed among them, by id.

        Raises:
            WaitError: the bridge publishes no diagnostics.
        """
        before = self._client.statuses.get(_LEFT_OUT)  # may be older than the last change
        self._client.wait_for(
            lambda: self._client.statuses.get(_LEFT_OUT) is not before,
            self._timeout_s,
            f"diagnostics {_LEFT_OUT!r}",
        )
        found: dict[int, str] = {}
        for name, text in self._client.statuses[_LEFT_OUT].values.items():
            kind, _, rest = name.partition(" ")
            if kind == "robot":
                found[int(rest)] = str(text)
            elif kind == _FURTHER:  # of many robots the last are not named one by one
                found |= dict.fromkeys(map(int, str(text).split()), rest)
        return found

    def _call(self, request: Callable[[], Future]) -> Any:
        wait_for = self._client.wait_for
        future = request()
        wait_for(future.done, self._timeout_s, f"answer of {_BRIDGE}")
        return future.result()


def disable(argv: Sequence[str] | None = None) -> int:
    """Run the command that takes robots out of use; return its exit code."""
    parser = _parser("disable", "Take robots out of use.")
    parser.add_argument("--why", default="", metavar="TEXT", help="reason, kept with their ids")

    def change(disabled: set[int], options: argparse.Namespace) -> tuple[set[int], str]:
        return disabled | set(options.ids), options.why

    return _run(parser, change, argv)


def enable(argv: Sequence[str] | None = None) -> int:
    """Run the command that puts robots back into use; return its exit code."""
    parser = _parser("enable", "Put disabled robots back into use.")
    parser.add_argument("--all", action="store_true", help="put back all disabled robots")

    def change(disabled: set[int], options: argparse.Namespace) -> tuple[set[int], str]:
        others = set(options.ids) - disabled
        if others:
            raise PlaneError(f"robot {min(others)} is not on the list of disabled robots")
        return set() if options.all else disabled - set(options.ids), ""

    return _run(parser, change, argv)


def _parser(name: str, purpose: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=name,
        description=f"{purpose}\n{_ABOUT}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("ids", metavar="ID", type=int, nargs="*", help="ids of robots")
    parser.add_argument(
        "--list", action="store_true", help="show the robots that are left out, and why"
    )
    parser.add_argument(
        "--timeout", type=float, default=20.0, metavar="S", help="time-out of each wait [s], 20"
    )
    return parser


def _run(parser: argparse.ArgumentParser, change: _Change, argv: Sequence[str] | None) -> int:
    args = sys.argv if argv is None else [parser.prog, *argv]
    options = parser.parse_args(remove_ros_args(args)[1:])
    changes = bool(options.ids) or getattr(options, "all", False)
    if not changes and not options.list:
        parser.error("name robots by their ids, or --list")
    use_loopback()
    try:
        with PlaneClient(args=args) as client:
            robots = DisabledRobots(client, options.timeout)
            disabled = set(robots.read())
            if changes:
                new, why = change(disabled, options)
                robots.write(new, why)
                disabled = new
            print(_table(disabled, robots.reasons()) if options.list else _summary(disabled))
    except FiberError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1
    return 0


def _summary(disabled: set[int]) -> str:
    if not disabled:
        return "no robot is disabled"
    return f"disabled: {', '.join(map(str, sorted(disabled)))}"


def _table(disabled: set[int], reasons: dict[int, str]) -> str:
    rows: list[tuple[object, ...]] = [("robot", "left out", "why")]
    rows += [
        (robot, "disabled" if robot in disabled else "failed", reasons.get(robot, ""))
        for robot in sorted(disabled | set(reasons))
    ]
    return table(rows) if len(rows) > 1 else "no robot is left out"
