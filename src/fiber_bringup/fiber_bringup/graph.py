"""The whole graph in one process, for scripts, notebooks and tests."""

import signal
import sys
import threading
import traceback

import rclpy
from rclpy.context import Context
from rclpy.logging import get_logger
from rclpy.parameter import Parameter

from fiber_bus_bridge.node import BridgeNode
from fiber_discretizer.node import DiscretizerNode
from fiber_node import ThreadExecutor
from fiber_node.ros_environment import use_loopback
from fiber_planner.node import PlannerNode
from fiber_recording.node import RecorderNode
from fiber_viewer.node import ViewerNode

__all__ = ["Graph", "main"]

_THREADS = 6  # one a node, and one for the bridge's stop


class Graph:
    """Planner, discretizer and bridge, running from `with` to its end.

    Each graph has a context of its own, so that one process can hold several in different
    domains. An exception that escapes a node ends the graph and is raised at the end of
    `with`.

    Args:
        planner: parameters of the planner node, by name.
        discretizer: parameters of the discretizer node.
        bridge: parameters of the bridge node.
        recorder: parameters of the recorder node; None for no recorder.
        viewer: parameters of the viewer node; None for no viewer.
        domain: ROS domain; by default that of the environment.
        args: command line for ROS, as ``["--ros-args", "-p", "bridge:robots:=61"]``.
    """

    def __init__(
        self,
        planner=None,
        discretizer=None,
        bridge=None,
        recorder=None,
        viewer=None,
        domain=None,
        args=(),
    ):
        self._parameters = [
            (BridgeNode, bridge or {}),
            (PlannerNode, planner or {}),
            (DiscretizerNode, discretizer or {}),
        ]
        for node, parameters in ((RecorderNode, recorder), (ViewerNode, viewer)):
            if parameters is not None:
                self._parameters.append((node, parameters))
        self._domain, self._args = domain, list(args)
        self._error: BaseException | None = None
        self.nodes: list = []

    def __enter__(self) -> "Graph":
        use_loopback()
        self._context = Context()
        rclpy.init(args=self._args, context=self._context, domain_id=self._domain)
        try:
            for node, parameters in self._parameters:
                overrides = [Parameter(name, value=value) for name, value in parameters.items()]
                self.nodes.append(node(context=self._context, parameter_overrides=overrides))
        except BaseException:
            self._leave()
            raise
        self._executor = ThreadExecutor(_THREADS, context=self._context)
        for node in self.nodes:
            self._executor.add_node(node)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="graph", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, kind, *_):
        # the loop ends before the executor, the callbacks before the nodes
        self._executor.stop()
        self._thread.join()
        self._executor.shutdown()
        self._leave()
        if self._error is not None and kind is None:
            raise self._error

    @property
    def running(self) -> bool:
        """Whether all nodes are up."""
        return not self._ended.is_set()

    def wait(self) -> None:
        """Wait until the graph ends by itself; an interrupt gets through."""
        # not by joining: until Python 3.13 an interrupted join takes its thread for ended
        self._ended.wait()

    def _spin(self):
        try:
            self._executor.spin()
        except BaseException as error:
            self._error = error
            said = "".join(traceback.format_exception(error))
            get_logger("graph").fatal(f"a node has died: {said}")
        finally:
            self._ended.set()

    def _leave(self):
        for node in self.nodes:
            node.destroy_node()
        self._context.try_shutdown()


def main(args=None) -> int:
    """Run the graph until it is interrupted."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with Graph(args=sys.argv[1:] if args is None else args) as graph:
            graph.wait()
    except KeyboardInterrupt:
        pass
    return 0
