"""Take robots out of use, and put them back: the operators' list of the bus bridge."""

import argparse
import sys

from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.utilities import remove_ros_args

from fiber_client.client import PlaneClient
from fiber_client.errors import PlaneError, PlaneRefusal
from fiber_client.terminal import table
from fiber_core.errors import FiberError
from fiber_node.ros_environment import use_loopback

__all__ = ["OperatorsList", "disable", "enable"]

_BRIDGE = "bridge"
_LEFT_OUT = "bridge: left out"
_ABOUT = """
Robots on the list are obstacles where they stand and end every plan as held, disabled. The bridge
keeps the list in the file of its parameter disabled_file, if that is set, over restarts. While
robots move the list stays as it is. Exit code 0 says that it is now as asked.
"""


class OperatorsList:
    """The list of disabled robots, as the bridge keeps it.

    Args:
        client: a client of the graph.
        timeout_s: of each answer [s].
    """

    def __init__(self, client: PlaneClient, timeout_s: float):
        self._client, self._timeout_s = client, timeout_s
        self._parameters = AsyncParameterClient(client.node, _BRIDGE)

    def read(self) -> list[int]:
        """Return the ids of the robots on it.

        Raises:
            WaitError: there is no bridge, or it does not answer.
        """
        answer = self._call(lambda: self._parameters.get_parameters(["disabled"]))
        return list(answer.values[0].integer_array_value) if answer.values else []

    def write(self, ids, why: str = "") -> None:
        """Make it another list.

        Args:
            ids: all robots that shall be on it.
            why: why those that are new are taken out.

        Raises:
            PlaneRefusal: the bridge refuses, with robot and reason.
            WaitError: there is no bridge, or it does not answer.
        """
        parameters = [
            Parameter("disabled_why", Parameter.Type.STRING, why),
            Parameter("disabled", Parameter.Type.INTEGER_ARRAY, sorted(ids)),
        ]
        answer = self._call(lambda: self._parameters.set_parameters_atomically(parameters))
        if not answer.result.successful:
            raise PlaneRefusal(_BRIDGE, answer.result.reason)

    def reasons(self) -> dict[int, str]:
        """Return why robots are left out of plans, those that failed among them, by id.

        Raises:
            WaitError: the bridge does not tell.
        """
        before = self._client.statuses.get(_LEFT_OUT)  # which may be older than what was changed
        self._client.wait_for(
            lambda: self._client.statuses.get(_LEFT_OUT) is not before,
            self._timeout_s,
            "word of who is left out",
        )
        told = self._client.statuses[_LEFT_OUT].values
        return {int(name.removeprefix("robot ")): why for name, why in told.items()}

    def _call(self, ask):
        wait = self._client.wait_for
        wait(self._parameters.services_are_ready, self._timeout_s, f"parameters of {_BRIDGE}")
        future = ask()
        wait(future.done, self._timeout_s, f"answer of {_BRIDGE}")
        return future.result()


def disable(argv=None) -> int:
    """Run the command that takes robots out of use."""
    parser = _parser("disable", "Take robots out of use.")
    parser.add_argument("--why", default="", metavar="TEXT", help="reason, kept beside their ids")

    def change(listed, options):
        return listed | set(options.ids), options.why

    return _run(parser, change, argv)


def enable(argv=None) -> int:
    """Run the command that puts robots back into use."""
    parser = _parser("enable", "Put robots back into use that were disabled.")
    parser.add_argument("--all", action="store_true", help="all that are on the list")

    def change(listed, options):
        others = set(options.ids) - listed
        if others:
            raise PlaneError(f"robot {min(others)} is not on the list of disabled robots")
        return set() if options.all else listed - set(options.ids), ""

    return _run(parser, change, argv)


def _parser(name, says):
    parser = argparse.ArgumentParser(
        prog=name,
        description=f"{says}\n{_ABOUT}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("ids", metavar="ID", type=int, nargs="*", help="ids of robots")
    parser.add_argument("--list", action="store_true", help="show who is out, and why")
    parser.add_argument(
        "--timeout", type=float, default=20.0, metavar="S", help="of each wait [s], default 20"
    )
    return parser


def _run(parser, change, argv) -> int:
    argv = remove_ros_args(sys.argv if argv is None else [parser.prog, *argv])[1:]
    options = parser.parse_args(argv)
    wants = bool(options.ids) or getattr(options, "all", False)
    if not wants and not options.list:
        parser.error("name robots by their ids, or --list")
    use_loopback()
    try:
        with PlaneClient() as client:
            operators = OperatorsList(client, options.timeout)
            listed = set(operators.read())
            if wants:
                new, why = change(listed, options)
                operators.write(new, why)
                listed = new
            print(_shown(listed, operators.reasons()) if options.list else _counted(listed))
    except FiberError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1
    return 0


def _counted(listed):
    if not listed:
        return "nobody is disabled"
    return f"disabled: {', '.join(map(str, sorted(listed)))}"


def _shown(listed, reasons):
    rows = [("robot", "out", "why")]
    rows += [
        (robot, "disabled" if robot in listed else "failed", reasons.get(robot, ""))
        for robot in sorted(listed | set(reasons))
    ]
    return table(rows) if len(rows) > 1 else "nobody is left out"
