# SPDX-License-Identifier: Apache-2.0
"""Vouch for the places of robots that do not answer, so that their neighbours may move again."""

import argparse
import sys
from collections.abc import Iterable, Sequence

import numpy as np
from rclpy.parameter import Parameter
from rclpy.utilities import remove_ros_args

from fiber_client.client import PlaneClient
from fiber_client.disable import DisabledRobots
from fiber_client.errors import PlaneRefusal
from fiber_client.terminal import table
from fiber_core.array_types import Rows
from fiber_core.errors import FiberError
from fiber_core.kinematics import forward
from fiber_node.ros_environment import use_loopback

__all__ = ["unknown_places", "vouch", "vouch_for"]

_BRIDGE, _UNKNOWN = "bridge", "place unknown"  # name and word of the diagnostics
_ABOUT = """
A robot that fell silent in motion, or was never read, may be anywhere that its joints reach, and
its neighbours rest. Look at it first: the list shows where the bridge assumes each of these
robots. If a robot rests there, vouch for it; it is then an obstacle in that place, and moves
itself only when it answers again. A wrong word can make arms touch. If a robot is elsewhere, do
not vouch: power it, and call clear, which reads its encoders; then home folds what may fold.
Exit code 0: the places are vouched for.
"""


def vouch_for(client: PlaneClient, ids: Iterable[int], timeout_s: float) -> None:
    """Tell the bridge that robots rest where it assumes them; an operator has looked.

    Args:
        client: a client of the graph.
        ids: ids of the robots.
        timeout_s: time-out of each answer [s].

    Raises:
        PlaneRefusal: the bridge refused, with robot and reason.
        WaitError: there is no bridge, or it does not answer.
    """
    new = Parameter("vouched", Parameter.Type.INTEGER_ARRAY, sorted(set(ids)))
    future = client.bridge_parameters(timeout_s).set_parameters([new])
    client.wait_for(future.done, timeout_s, f"answer of {_BRIDGE}")
    answer = future.result()
    assert answer is not None  # the wait is over
    (result,) = answer.results
    if not result.successful:
        raise PlaneRefusal(_BRIDGE, result.reason)


def unknown_places(client: PlaneClient, timeout_s: float) -> list[int]:
    """Return the ids of the robots whose places are not known, as far as diagnostics name them.

    Raises:
        WaitError: the bridge publishes no diagnostics.
    """
    reasons = DisabledRobots(client, timeout_s).reasons()
    return [robot for robot, why in sorted(reasons.items()) if why.startswith(_UNKNOWN)]


def vouch(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    parser = argparse.ArgumentParser(
        prog="vouch",
        description=f"Vouch for the places of robots that do not answer.\n{_ABOUT}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("ids", metavar="ID", type=int, nargs="*", help="ids of robots")
    parser.add_argument(
        "--list", action="store_true", help="show the robots of unknown places; vouch for none"
    )
    parser.add_argument(
        "--timeout", type=float, default=20.0, metavar="S", help="time-out of each wait [s], 20"
    )
    args = sys.argv if argv is None else [parser.prog, *argv]
    options = parser.parse_args(remove_ros_args(args)[1:])
    if bool(options.ids) == options.list:
        parser.error("name robots by their ids, or --list")
    use_loopback()
    try:
        with PlaneClient(args=args) as client:
            if options.list:
                unknown = unknown_places(client, options.timeout)
                client.wait_for_graph(options.timeout)
                print(_table(client, unknown))
            else:
                vouch_for(client, options.ids, options.timeout)
                print(f"vouched for: {', '.join(map(str, sorted(set(options.ids))))}")
    except FiberError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1
    return 0


def _table(client: PlaneClient, ids: Sequence[int]) -> str:
    """Where robots are assumed."""
    if not ids:
        return "the places of all robots are known"
    rows: Rows = client.plane.index_of(np.asarray(ids))
    degrees = np.rad2deg(client.angles[rows])
    xy_mm = forward(client.plane, client.angles)[1][rows]
    lines: list[tuple[object, ...]] = [("robot", "theta [deg]", "phi [deg]", "x [mm]", "y [mm]")]
    lines += [
        (robot, f"{theta:.2f}", f"{phi:.2f}", f"{x:.2f}", f"{y:.2f}")
        for robot, (theta, phi), (x, y) in zip(ids, degrees, xy_mm)
    ]
    return table(lines)
