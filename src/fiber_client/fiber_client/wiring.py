# SPDX-License-Identifier: Apache-2.0
"""Tell with a camera which robot the orders for each robot move: swapped plugs, fibres, addresses.

A procedure of `fiber_metrology.tell_wiring` on a running plane.
"""

import argparse
import json
import sys
from collections.abc import Callable, Sequence

import numpy as np
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import PointCloud2

from fiber_client.client import PlaneClient
from fiber_client.errors import PlaneRefusal
from fiber_client.turning import Turning
from fiber_core.array_types import Angles, Ids
from fiber_core.errors import FiberError
from fiber_formats import kind_of, write_table
from fiber_metrology import CodeWords, Lights, Wiring, WiringConfig, code_words, tell_wiring
from fiber_msgs_py import PlanStamp, lights, topics
from fiber_node.ros_environment import use_loopback

__all__ = ["main", "read_wiring"]

_LEAST = 0.5  # share of a full turn, below which a robot counts as one that rested
_STEADY = 0.2  # a turn that is off by such a share of it was not made as told
_MOST_ODD = 0.25  # share of the images in which turns may be so
_AGAIN = 2  # images that are taken anew after one that cannot be used
_ABOUT = """
Before each image phi of every robot turns up or down by a word of its own, so little that nothing
can touch: no point of an arm moves by more than half of the gap that it had, and half of the margin
at most. The lights that move by a word are those of the robot that was told to make it, wherever
they are. At the end all robots turn back. Nothing is learned from these images but what is told.
Robots whose gaps allow no such turn rest, and nothing is told of them. Exit code 0: every robot is
at its own place.
"""


def read_wiring(
    client: PlaneClient, timeout_s: float, images: int = 32, seed: int = 0,
    error_um: float = 4.5, say: Callable[[str], None] = lambda _: None,
) -> Wiring:  # fmt: skip
    """Turn robots by code words, take an image after each, and tell which order moves which fibre.

    Args:
        client: a client of a graph with a metrology and a camera.
        timeout_s: time-out of each wait [s].
        images: number of images, 16 or 32.
        seed: of the code words.
        error_um: rms error of one coordinate of a place in an image [um].
        say: called with a line for each image.

    Raises:
        PlaneRefusal: the bridge or the metrology refuses; gives the reason. Robots that can turn
            back have done so.
        NodeLost, WaitError: as in the calls of the client.
    """
    return _Procedure(client, timeout_s, say).run(images, seed, error_um)


class _Procedure:
    def __init__(self, client: PlaneClient, timeout_s: float, say: Callable[[str], None]):
        self._client, self._timeout_s, self._say = client, timeout_s, say
        self._turning = Turning(client, timeout_s)
        self._look = topics.LOOK.client(client.node)
        self._lights = client.collect(topics.LIGHTS)

    def run(self, images: int, seed: int, error_um: float) -> Wiring:
        client, plane = self._client, self._client.plane
        words = code_words(plane, np.random.default_rng(seed), images)
        rest, taken, turned = client.angles, [], np.zeros((plane.n, images))
        try:
            for k, up in enumerate(words.bits.T):
                made = self._turning.turn_words(plane.ids, np.where(up, 1, -1))
                taken.append(self._image(PlanStamp(made.stamp_ns)))
                turned[:, k] = (client.angles - rest)[:, 1]
                self._say(f"image {k + 1} of {images}: {len(taken[-1].places)} lights")
        except PlaneRefusal:
            self._turn_back(plane.ids)
            raise
        self._turn_back(plane.ids)
        return tell_wiring(plane, _made(words, turned), taken, WiringConfig(error_um=error_um))

    def _turn_back(self, ids: Ids) -> None:
        try:
            self._turning.turn_words(ids, np.zeros(len(ids), dtype=np.int64))
        except PlaneRefusal as refusal:
            self._say(f"robots did not turn back: {refusal}")

    def _image(self, motion: PlanStamp) -> Lights:
        for _ in range(_AGAIN):
            try:
                return self._one_image(motion)
            except PlaneRefusal as refusal:  # the metrology may hear late that a motion has ended
                self._say(f"{refusal}; another image is taken")
        return self._one_image(motion)

    def _one_image(self, motion: PlanStamp) -> Lights:
        client = self._client
        client.wait_for(self._look.service_is_ready, self._timeout_s, "service look of a metrology")
        future = self._look.call_async(topics.LOOK.type.Request())
        client.wait_for(future.done, self._timeout_s, "answer of look")
        answer = future.result()
        if answer is None or not answer.success:
            raise PlaneRefusal("metrology", answer.message if answer else "no answer")

        def come() -> list[PointCloud2]:
            return [each for each in self._lights if PlanStamp.of(each) == motion]

        client.wait_for(come, self._timeout_s, f"lights after motion {motion}")
        seen = lights.decode(come()[-1])
        self._lights.clear()
        none = np.zeros((len(seen.places), 2), dtype=np.int64)
        return Lights(seen.places, seen.seen, seen.merged, int(seen.seen.max(initial=1)), [], none)


def _made(words: CodeWords, turned: Angles) -> CodeWords:
    """The words with the turns that the encoders read; 0 of robots that did not turn as told."""
    up, down = (
        np.nanmedian(np.where(bits, turned, np.nan), axis=1) for bits in (words.bits, ~words.bits)
    )
    turn = np.maximum(np.stack([-down, up], axis=1), 0.0)
    told = np.where(words.bits, turn[:, 1:], -turn[:, :1])
    size = turn.sum(axis=1)
    odd = np.abs(turned - told) > _STEADY * size[:, None]
    rested = odd.mean(axis=1) > _MOST_ODD
    rested |= size < _LEAST * words.turn_rad.sum(axis=1) / 2.0  # one way alone is enough
    return CodeWords(words.bits, np.where(rested[:, None], 0.0, turn))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    parser = argparse.ArgumentParser(
        prog="wiring",
        description=f"{(__doc__ or '').strip()}\n{_ABOUT}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add("table", nargs="?", metavar="TABLE", help="a table to write: .csv, .ecsv or .fits")
    add("--images", type=int, default=32, metavar="N", help="number of images, 32 or 16")
    add("--seed", type=int, default=0, help="of the code words")
    add("--error-um", type=float, default=4.5, help="error of a coordinate of a light [um], 4.5")
    add("--timeout", type=float, default=60.0, metavar="S", help="time-out of each wait [s], 60")
    args = sys.argv if argv is None else [parser.prog, *argv]
    options = parser.parse_args(remove_ros_args(args)[1:])
    use_loopback()
    try:
        if options.table is not None:
            kind_of(options.table)
        with PlaneClient(args=args) as client:
            client.wait_for_graph(options.timeout)
            found = read_wiring(
                client, options.timeout, options.images, options.seed, options.error_um, print
            )
            plane = client.plane
            if options.table is not None:
                write_table(options.table, found.columns(plane))
    except FiberError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 1
    lines = found.lines(plane)
    print("\n".join([*lines, json.dumps(found.counts())]))
    return int(bool(lines))
