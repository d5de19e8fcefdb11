# SPDX-License-Identifier: Apache-2.0
"""The node `console`: a running plane in a browser, in a process of its own.

It receives what all observers receive, and sends orders only when a browser asks for them. Nothing
waits for it: when it ends or hangs, the plane goes on.
"""

import asyncio
import atexit
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown
from sensor_msgs.msg import JointState, PointCloud2

from fiber_console.errors import ConsoleError
from fiber_console.orders import BridgeOrders
from fiber_console.plane_feed import PlaneFeed
from fiber_console.server import ConsoleServer, kept_token
from fiber_core.bounds import Range, check_ranges
from fiber_core.errors import FiberError
from fiber_core.outcomes import PlanOutcome
from fiber_msgs_py import (
    PlanStamp,
    diagnostics,
    joint_states,
    layout,
    outcome,
    progress,
    targets,
    topics,
)
from fiber_node import PlaneNode, Reporter, SessionGate, ThreadExecutor, warn_of_sections
from fiber_node.deafness import watch_hearing
from fiber_node.ros_environment import keep_memory_private, keep_private, use_loopback

__all__ = ["ConsoleConfig", "ConsoleNode", "main", "serve"]

_THREADS = 3
_ANSWER_S = 20.0  # longest wait for an answer of the bridge


@dataclass(frozen=True)
class ConsoleConfig:
    """Where the console is served.

    Args:
        port: port on loopback; 0 for any that is free.
        folder: folder of the recordings that can be opened.
        token_file: file of the token that browsers need; empty for one beside the logs of ROS.

    Raises:
        FiberError: the port is no whole number or out of bounds.
    """

    RANGES: ClassVar = {"port": Range(0, 65535, whole=True)}

    port: int = 8137
    folder: str = "recordings"
    token_file: str = ""

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, FiberError)


class ConsoleNode(PlaneNode):
    """Follows a plane for browsers.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options: Any):
        super().__init__("console", **options)
        self.config = self.parameters.declare(ConsoleConfig, read_only=True).value
        self.parameters.finish()
        self.feed = PlaneFeed()
        self.orders = BridgeOrders(self, self.feed.bridge_node, _ANSWER_S)
        self.server: ConsoleServer | None = None
        self._layout: bytes | None = None
        self._report = Reporter(self, "console")
        gate = SessionGate(self, self._report.refuse_message)
        for topic, observe in (
            (topics.LAYOUT, self._on_layout),
            (topics.JOINT_STATES, self._on_joint_states),
            (topics.OUTCOME, self._on_outcome),
        ):
            gate.subscription(topic, self._refusing(topic.name, observe))
        for topic, observe in (
            (topics.TARGETS, self._on_targets),
            (topics.PROGRESS, self._on_progress),
            (topics.DIAGNOSTICS, self._on_diagnostics),
        ):
            topic.subscription(self, self._refusing(topic.name, observe))

    def _refusing(self, topic: str, observe: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a callback that reports why a message was refused, and tells the browsers."""
        name = topic.rpartition("/")[2]

        def receive(message: Any) -> None:
            try:
                observe(message)
            except FiberError as error:
                self._report.refuse(f"{name} refused: {error}", name)
            server = self.server  # another thread ends it
            if server is not None:
                server.touch()

        return receive

    def _on_layout(self, message: PointCloud2) -> None:
        content = bytes(message.data)
        if content != self._layout:  # it comes again and again
            self.feed.set_plane(layout.decode(message)[0])
            self._layout = content

    def _on_joint_states(self, message: JointState) -> None:
        _, angles, speeds, _ = joint_states.decode(message)
        server = self.server  # another thread ends it
        if server is not None:
            server.send_motion(self.feed.motion_message(angles, speeds))

    def _on_outcome(self, message: PointCloud2) -> None:
        stamp = PlanStamp.of(message)
        self.feed.set_outcome(PlanOutcome(stamp.ns, *outcome.decode(message)))

    def _on_targets(self, message: PointCloud2) -> None:
        if targets.decode_attempt(message).number == 1:  # later ones have some of these again
            self.feed.set_targets(*targets.decode(message)[:2])

    def _on_progress(self, message: DiagnosticStatus) -> None:
        self.feed.add_progress(progress.decode(message))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for received in diagnostics.decode(message):
            status = received.of_namespace(self.get_namespace())
            if status is not None:
                self.feed.add_status(status)


def _token_file(config: ConsoleConfig) -> Path:
    if config.token_file:
        return Path(config.token_file)
    logs = os.environ.get("ROS_LOG_DIR") or Path.home() / ".ros" / "log"
    return Path(logs).parent / "fiber_console.token"


async def serve(node: ConsoleNode, ended: asyncio.Event) -> None:
    """Serve a node that runs in another thread, until an event is set.

    Args:
        node: the node.
        ended: ends the server.

    Raises:
        ConsoleError: the port is taken, or the token cannot be kept.
    """
    config = node.config
    token = kept_token(_token_file(config))
    server = ConsoleServer(node.feed, node.orders, token, Path(config.folder), config.port)
    node.server = server
    # not to the log, which other nodes hear: the address has the token
    print(f"the console is at {server.address}", flush=True)
    try:
        await ended.wait()
    finally:
        node.server = None
        server.close()


class _FirstSignal:
    """A handler of signals that acts on the first alone: others do not break into the end.

    It raises KeyboardInterrupt, or calls `end` where that is set.
    """

    def __init__(self) -> None:
        self.end: Callable[[], object] | None = None
        self.came = False

    def __call__(self, *_: object) -> None:
        if self.came:
            return
        self.came = True
        if self.end is None:
            raise KeyboardInterrupt
        self.end()


async def _run(node: ConsoleNode, interrupt: _FirstSignal) -> None:
    ended, loop = asyncio.Event(), asyncio.get_running_loop()
    interrupt.end = lambda: loop.call_soon_threadsafe(ended.set)
    if interrupt.came:
        ended.set()
    try:
        await serve(node, ended)
    finally:
        interrupt.end = lambda: None  # it ends anyway, and the loop may be closed


def main(args: Sequence[str] | None = None) -> int:
    """Run the console until it is interrupted; return the exit code.

    Args:
        args: arguments for ROS; by default those of the process.
    """
    use_loopback()
    keep_private()
    # a signal ends the loop of asyncio, which ends the rest; before it runs it is an interrupt
    interrupt = _FirstSignal()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
        # Python gives handlers back to the system before it has ended
        atexit.register(signal.signal, number, signal.SIG_IGN)
    given = list(sys.argv if args is None else args)
    rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    code, executor, node = 0, ThreadExecutor(_THREADS), None
    thread = threading.Thread(target=executor.spin, name="console", daemon=True)
    try:
        node = ConsoleNode()
        keep_memory_private()
        watch_hearing()
        warn_of_sections(node, given)
        executor.add_node(node)
        thread.start()
        interrupt.end = lambda: None  # an interrupt would leave the loop half made: _run looks
        asyncio.run(_run(node, interrupt))
    except (ConsoleError, FiberError) as error:
        print(f"console: {error}", file=sys.stderr)
        code = 2
    except KeyboardInterrupt:
        pass
    finally:
        executor.stop()
        if thread.is_alive():
            thread.join()
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        try_shutdown()
    return code
