# SPDX-License-Identifier: Apache-2.0
"""Find robots at unknown places with a camera, so that they come back into use."""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from rclpy.utilities import remove_ros_args

from fiber_client.client import PlaneClient
from fiber_client.closed_loop import CameraLoop
from fiber_client.errors import PlaneRefusal
from fiber_client.stop_turns import StopSearch
from fiber_client.turning import Turning
from fiber_core.array_types import Ids, Mask
from fiber_core.errors import FiberError
from fiber_core.outcomes import Verdict
from fiber_msgs_py import layout, topics
from fiber_node.ros_environment import use_loopback

__all__ = ["Recovery", "main", "recover"]

_TURNS = 4
_SHOWN = 20
_ABOUT = """
The counters of robots that lost their power tell nothing, where the bridge has the parameter
session.counters_kept false. The command asks all robots anew (the service configure) and takes
images between small turns of theta of all such robots at once. Each turn moves no point of an
arm by more than half of the margin that the last certificate left, so nothing can touch. The light
of each robot turns about its own axis and tells where its arms are. The command ends when
no robot is left with a light in its reach that may be its own. Robots that stand where two turns of
theta are in range then turn to their stops, to one and to the other, no two neighbours at once: a
robot that a stop does not hold is seen after it where one turn alone is in range. Exit code 0: all
robots that answer are in use again.
"""


@dataclass(frozen=True)
class Recovery:
    """Which robots were found.

    Args:
        lost: robots that were at unknown places.
        found: those that are in use again.
        turn_unknown: those that were seen and still have another turn of theta in their range:
            they rest, and hinder no other robot.
        left: those that no image tells; their neighbours rest.
        turns: number of test turns.
        stop_turns: number of turns to stops.
        notes: what was tried with each robot of `turn_unknown`.
    """

    lost: Ids
    found: Ids
    turn_unknown: Ids
    left: Ids
    turns: int
    stop_turns: int
    notes: Sequence[str]


def recover(
    client: PlaneClient, timeout_s: float, turns: int = _TURNS,
    say: Callable[[str], None] = lambda _: None, to_stops: bool = True,
) -> Recovery:  # fmt: skip
    """Find the robots at unknown places.

    Args:
        client: a client of a graph with a metrology and a camera.
        timeout_s: time-out of each wait [s].
        turns: largest number of test turns, and of those after each turn to stops.
        say: called with a line for each image.
        to_stops: whether robots turn to their stops of which another turn of theta is in range.

    Raises:
        PlaneRefusal: the bridge or the metrology refuses; gives the reason.
        NodeLost, WaitError: as in the calls of the client.
    """
    say(client.call_service(topics.CONFIGURE, timeout_s))
    client.wait_for_graph(timeout_s)
    ids, lost = client.plane.ids, _lost(client) | (client.unplaced == layout.SEEN)
    say(f"{lost.sum()} robots at unknown places")
    search = _Search(client, timeout_s, turns, say)
    search.find(np.ones(len(ids), dtype=bool))
    stops = StopSearch(client, search.turning, timeout_s, search.find, say)
    if to_stops:
        stops.run()
    left, seen = _lost(client), client.unplaced == layout.SEEN
    return Recovery(
        ids[lost], ids[lost & ~left & ~seen], ids[lost & seen], ids[left], search.made,
        stops.motions, stops.notes(ids[lost & seen]),
    )  # fmt: skip


class _Search:
    """Takes images between test turns."""

    def __init__(
        self, client: PlaneClient, timeout_s: float, turns: int, say: Callable[[str], None]
    ):
        self._client, self._turns, self._say = client, turns, say
        self._loop = CameraLoop(client, 1.0, 0, timeout_s)  # for its images alone
        self.turning, self.made = Turning(client, timeout_s), 0

    def find(self, among: Mask) -> None:
        """Find robots at unknown places, those of `among` and others, until none of these is left.

        Args:
            among: robots for which test turns are made, shape (n,).
        """
        client, first = self._client, self.made
        if not (_lost(client) & among).any():
            return
        # robots that another image may tell: not those without a light in their reach
        lit = _take_image(client, self._loop)
        while (_lost(client) & lit & among).any() and self.made < first + self._turns:
            try:
                self.turning.turn_unplaced()
            except PlaneRefusal as refusal:
                if self.made == 0:
                    raise
                self._say(str(refusal))  # what was found stays found
                break
            self.made += 1
            lit = _take_image(client, self._loop)
            self._say(
                f"after test turn {self.made}: {_lost(client).sum()} robots at unknown places, "
                f"{(_lost(client) & lit).sum()} of them beside a light that may be theirs"
            )


def _take_image(client: PlaneClient, loop: CameraLoop) -> Mask:
    """Take an image, and wait until the layout tells which robots it has found.

    Returns:
        The robots but those of which the image shows no light, shape (n,).
    """
    try:
        image = loop.take_image()
    except PlaneRefusal:  # counters that were set just before may have come late: once more
        image = loop.take_image()
    found = image.ids[np.isfinite(image.places[:, 0])]
    rows = client.plane.index_of(found)
    client.wait_for(
        lambda: not _lost(client)[rows].any(), loop.timeout_s, "the robots found at known places"
    )
    none = image.ids[np.isin(image.verdict, (Verdict.MISSING, Verdict.DARK))]
    return ~np.isin(client.plane.ids, none)


def _lost(client: PlaneClient) -> Mask:
    return (client.unplaced > 0) & (client.unplaced != layout.SEEN)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    parser = argparse.ArgumentParser(
        prog="recover",
        description=f"{(__doc__ or '').strip()}\n{_ABOUT}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--turns", type=int, default=_TURNS, metavar="N",
        help=f"largest number of test turns, {_TURNS}",
    )  # fmt: skip
    parser.add_argument(
        "--timeout", type=float, default=60.0, metavar="S", help="time-out of each wait [s], 60"
    )
    parser.add_argument(
        "--no-stops", action="store_true", help="turn no robot to a stop: robots of which another "
        "turn of theta is in range rest",
    )  # fmt: skip
    args = sys.argv if argv is None else [parser.prog, *argv]
    options = parser.parse_args(remove_ros_args(args)[1:])
    use_loopback()
    try:
        with PlaneClient(args=args) as client:
            client.wait_for_graph(options.timeout)
            ended = recover(client, options.timeout, options.turns, print, not options.no_stops)
    except FiberError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1
    print(f"{len(ended.found)} of {len(ended.lost)} robots are in use again")
    noted = [f"{robot} ({note})" for robot, note in zip(ended.turn_unknown, ended.notes)]
    for robots, text in (
        (noted, "seen, and another turn of theta is in range: they rest"),
        (ended.left.tolist(), "not found: they and their neighbours rest"),
    ):
        if robots:
            more = f" and {len(robots) - _SHOWN} more" if len(robots) > _SHOWN else ""
            print(f"{text}: robots {', '.join(map(str, robots[:_SHOWN]))}{more}")
    return int(bool(len(ended.left) or len(ended.turn_unknown)))
