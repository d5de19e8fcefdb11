"""Run a node as a process."""

from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node

from fiber_core.errors import FiberError

__all__ = ["run"]


def run(make_node: Callable[[], Node], args=None) -> int:
    """Build a node and spin it until it is interrupted; return the exit code.

    Settings a core refuses end the process with their message and code 2. Two threads
    spin, so that a call in a callback group of its own is served while another works.

    Args:
        make_node: called once rclpy is initialised.
        args: command line for ROS.
    """
    rclpy.init(args=args)
    executor, code = MultiThreadedExecutor(num_threads=2), 0
    try:
        executor.add_node(make_node())
        executor.spin()
    except FiberError as error:
        rclpy.logging.get_logger("fiber").fatal(str(error))
        code = 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # the signal has shut rclpy down already
    finally:
        # a node may not go before what is at work in its threads, and shutdown does not wait
        executor._executor.shutdown()
        nodes = executor.get_nodes()
        executor.shutdown()
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    return code
