"""Shared parts of all nodes: parameters, progress and diagnostics, the plane, the main loop."""

from fiber_node.attempt_listener import AttemptListener
from fiber_node.parameters import Declared, NodeParameters, ParameterError
from fiber_node.plane_cache import PlaneCache
from fiber_node.plane_node import PlaneNode
from fiber_node.reporter import Reporter
from fiber_node.ros_client import RosClient, WaitError
from fiber_node.run_node import run
from fiber_node.thread_executor import ThreadExecutor
from fiber_node.worker import WorkCancelled, Worker

__all__ = [
    "AttemptListener",
    "Declared",
    "NodeParameters",
    "ParameterError",
    "PlaneCache",
    "PlaneNode",
    "Reporter",
    "RosClient",
    "ThreadExecutor",
    "WaitError",
    "WorkCancelled",
    "Worker",
    "run",
]
