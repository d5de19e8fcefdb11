# SPDX-License-Identifier: Apache-2.0
"""Run a node as a process."""

import atexit
import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.utilities import get_default_context, remove_ros_args, try_shutdown

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
        make_node: called once rclpy is initialised; its docstring is the help.
        args: command line for ROS, with the name of the program first; by default that of the
            process. Any other argument ends the process with code 2.
    """
    given = sys.argv if args is None else list(args)
    code = _of_ros_alone(make_node, given)
    if code is not None:
        return code
    use_loopback()
    keep_private()
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, _interrupt_once())
        # Python gives handlers back to the system before it has ended
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
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


def _interrupt_once() -> Callable[[int, FrameType | None], None]:
    """Return a handler that raises KeyboardInterrupt for the first signal alone.

    A terminal signals the whole group of a launch, and without a terminal the launch signals each
    process again: the second signal would break into the end that the first has begun.
    """
    first = iter((True,))

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        if next(first, False):
            raise KeyboardInterrupt

    return interrupt


def _of_ros_alone(make_node: Callable[[], Node], given: Sequence[str]) -> int | None:
    """Return the exit code of a command line that asks for help, or has what is not for ROS."""
    others = remove_ros_args(given)[1:]
    if not others:
        return None
    asked = any(each in ("-h", "--help") for each in others)
    if not asked:
        print(f"unknown arguments: {' '.join(others)}", file=sys.stderr)
    name = os.path.basename(given[0])
    about = (make_node.__doc__ or "A node.").splitlines()[0]
    print(
        f"usage: {name} [--ros-args [-p PARAMETER:=VALUE] [--params-file FILE] [-r __ns:=/NAME] "
        f"[--log-level LEVEL]]\n\n{about}\n\nIts parameters are in docs/interfaces.md; while it "
        f"runs, `ros2 param describe {name} PARAMETER` explains one.",
        file=sys.stdout if asked else sys.stderr,
    )
    return 0 if asked else 2
