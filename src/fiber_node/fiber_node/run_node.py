# SPDX-License-Identifier: Apache-2.0
"""Run a node as a process."""

import gc
import os
import sys
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.utilities import get_default_context, try_shutdown

from fiber_core.errors import FiberError
from fiber_node.deafness import watch_hearing
from fiber_node.params_files import warn_of_sections
from fiber_node.ros_environment import keep_memory_private, keep_private, use_loopback
from fiber_node.thread_executor import ThreadExecutor

__all__ = ["run"]


def run(make_node: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Build a node and run it until it is interrupted; return the exit code.

    Parameters that a core refuses end the process with their message and code 2. Three threads run
    callbacks, so that parameters and a callback in a group of its own, such as the service stop,
    are served while another is at work. Work
    of a Worker is cancelled, and the process ends within a second.

    The node is on loopback if the environment does not say otherwise, and what it writes can be
    read by its owner only.

    Args:
        make_node: called once rclpy is initialised.
        args: command line for ROS; by default that of the process.
    """
    use_loopback()
    keep_private()
    given = sys.argv if args is None else list(args)
    rclpy.init(args=given)
    executor, code = ThreadExecutor(3), 0
    try:
        node = make_node()
        keep_memory_private()
        watch_hearing()
        warn_of_sections(node, given)
        executor.add_node(node)
        executor.spin()
    except FiberError as error:
        get_logger("fiber").fatal(str(error))
        code = 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # the signal has shut rclpy down already
    except Exception:
        if get_default_context().ok():
            raise
        # after a signal whatever is sent fails, wherever the node is
    finally:
        # the end of Python would look through each object of the compiled loops: 0.2 s
        gc.freeze()
        nodes = executor.get_nodes()
        executor.shutdown()  # a node must not go before its callbacks have returned
        for node in nodes:
            node.destroy_node()
        try_shutdown()
    if not all(getattr(node, "ended", True) for node in nodes):
        # work that does not follow its cancellation may go on for a minute; this process shall not
        sys.stderr.flush()
        os._exit(code)
    return code
