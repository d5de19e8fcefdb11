# SPDX-License-Identifier: Apache-2.0
"""The whole node graph in one process, for scripts, notebooks and tests."""

import signal
import sys
import threading
import traceback
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType

import rclpy
from rclpy.context import Context
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.parameter import Parameter

from fiber_bus_bridge.node import BridgeNode
from fiber_discretizer.node import DiscretizerNode
from fiber_metrology.camera.node import CameraNode
from fiber_metrology.node import MetrologyNode
from fiber_node import ThreadExecutor
from fiber_node.ros_environment import use_loopback
from fiber_planner.node import PlannerNode
from fiber_recording.node import RecorderNode
from fiber_viewer.node import ViewerNode

__all__ = ["Graph", "main"]

_THREADS = 8  # one for each node, and three for work, parameters and service stop of the bridge

_Parameters = Mapping[str, object]


class Graph:
    """Bridge, planner and discretizer, with recorder and viewer where requested, in one process.

    The nodes run from `with` to its end. Each graph has a context of its own, so that one process
    can hold several graphs in different domains. An exception in a callback of a topic or a service
    is reported and does not end a node; any other that escapes a node ends the graph and is raised
    at the end of `with`. `nodes` are the nodes.

    Args:
        planner: parameters of the planner node, by name.
        discretizer: parameters of the discretizer node.
        bridge: parameters of the bridge node.
        recorder: parameters of the recorder node; None for no recorder.
        viewer: parameters of the viewer node; None for no viewer.
        metrology, camera: parameters of these nodes; None for none of them.
        domain: ROS domain; by default the domain of the environment.
        args: command line for ROS, such as ``["--ros-args", "-p", "bridge:robots:=61"]``.
    """

    def __init__(
        self,
        planner: _Parameters | None = None,
        discretizer: _Parameters | None = None,
        bridge: _Parameters | None = None,
        recorder: _Parameters | None = None,
        viewer: _Parameters | None = None,
        metrology: _Parameters | None = None,
        camera: _Parameters | None = None,
        domain: int | None = None,
        args: Sequence[str] = (),
    ):
        self._parameters: list[tuple[Callable[..., Node], _Parameters]] = [
            (BridgeNode, bridge or {}),
            (PlannerNode, planner or {}),
            (DiscretizerNode, discretizer or {}),
        ]
        for node, parameters in (
            (RecorderNode, recorder), (ViewerNode, viewer), (MetrologyNode, metrology),
            (CameraNode, camera),
        ):  # fmt: skip
            if parameters is not None:
                self._parameters.append((node, parameters))
        self._domain, self._args = domain, list(args)
        self._error: BaseException | None = None
        self.nodes: list[Node] = []

    def __enter__(self) -> "Graph":
        use_loopback()
        self._context = Context()
        rclpy.init(args=self._args, context=self._context, domain_id=self._domain)
        try:
            for node, parameters in self._parameters:
                overrides = [Parameter(name, value=value) for name, value in parameters.items()]
                self.nodes.append(node(context=self._context, parameter_overrides=overrides))
        except BaseException:
            self._destroy_nodes()
            raise
        self._executor = ThreadExecutor(_THREADS, context=self._context)
        for node in self.nodes:
            self._executor.add_node(node)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="graph", daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        # the loop ends before the executor, all callbacks end before the nodes
        self._executor.stop()
        self._thread.join()
        self._executor.shutdown()
        self._destroy_nodes()
        if self._error is not None and error is None:
            raise self._error

    @property
    def running(self) -> bool:
        """Whether all nodes run."""
        return not self._ended.is_set()

    def wait(self) -> None:
        """Wait until the graph ends by itself; an interrupt ends the wait."""
        # on the event and not on the thread: until Python 3.13 an interrupted join marks its
        # thread as ended
        self._ended.wait()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except BaseException as error:
            self._error = error
            trace = "".join(traceback.format_exception(error))
            get_logger("graph").fatal(f"a node has died: {trace}")
        finally:
            self._ended.set()

    def _destroy_nodes(self) -> None:
        for node in self.nodes:
            node.destroy_node()
        self._context.try_shutdown()


def main(args: Sequence[str] | None = None) -> int:
    """Run the graph until it is interrupted; return the exit code."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with Graph(args=sys.argv[1:] if args is None else args) as graph:
            graph.wait()
    except KeyboardInterrupt:
        pass
    return 0
