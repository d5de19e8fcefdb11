# SPDX-License-Identifier: Apache-2.0
"""Shared parts of all nodes: parameters, progress and diagnostics, the plane, the main loop."""

from fiber_node.accepted_attempts import AcceptedAttempts
from fiber_node.claims import BRIDGE, DISCRETIZER, PLANNER, Claim, claims
from fiber_node.managed_node import ManagedNode
from fiber_node.parameters import Declared, NodeParameters, ParameterError
from fiber_node.params_files import warn_of_sections
from fiber_node.plane_cache import PlaneCache
from fiber_node.plane_node import PlaneNode
from fiber_node.repeated_request import RepeatedRequest
from fiber_node.reporter import Reporter
from fiber_node.ros_client import RosClient, WaitError
from fiber_node.run_node import run
from fiber_node.session_gate import SessionGate
from fiber_node.thread_executor import ThreadExecutor
from fiber_node.worker import WorkCancelled, Worker

__all__ = [
    "AcceptedAttempts",
    "BRIDGE",
    "Claim",
    "DISCRETIZER",
    "Declared",
    "ManagedNode",
    "NodeParameters",
    "PLANNER",
    "ParameterError",
    "PlaneCache",
    "PlaneNode",
    "RepeatedRequest",
    "Reporter",
    "RosClient",
    "SessionGate",
    "ThreadExecutor",
    "WaitError",
    "WorkCancelled",
    "Worker",
    "claims",
    "run",
    "warn_of_sections",
]
