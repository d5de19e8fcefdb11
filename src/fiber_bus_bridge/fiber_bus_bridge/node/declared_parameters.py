# SPDX-License-Identifier: Apache-2.0
"""All parameters of the bridge, declared before any robot is asked."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

from fiber_bus_bridge.node.disabled_parameter import DisabledParameters, declare_disabled
from fiber_bus_bridge.node.hardware import DeclaredHardware, declare_hardware
from fiber_bus_bridge.node.outlines import BlindErrors
from fiber_bus_bridge.node.remembered import MemoryConfig
from fiber_bus_bridge.node.settings import AttemptConfig, ExecutionConfig, StartConfig
from fiber_bus_bridge.node.vouched_parameter import declare_vouched
from fiber_bus_bridge.session_config import SessionConfig
from fiber_core.clearance import Safety
from fiber_node import Declared, NodeParameters

__all__ = ["BridgeParameters", "declare_bridge"]


@dataclass(frozen=True, eq=False)
class BridgeParameters:
    """The parameters of the bridge with the values that they were given.

    Args:
        hardware: the robots and their buses.
        safety: the clearance that is required of the loaded bytes.
        errors: errors of blind moves, which outlines hold.
        execution: pace of simulated buses, captures, wait for other bridges.
        attempts: attempts of a plan; can change.
        start: the plan of the next start; can change.
        session: the controller's settings.
        memory: where robots are remembered over a restart.
        disabled: the operators' list; can change.
        own: the parameters of a derived node, by their prefix.
    """

    hardware: DeclaredHardware
    safety: Safety
    errors: BlindErrors
    execution: ExecutionConfig
    attempts: Declared[AttemptConfig]
    start: Declared[StartConfig]
    session: SessionConfig
    memory: MemoryConfig
    disabled: DisabledParameters
    own: Mapping[str, Any]


def declare_bridge(
    node: Node, parameters: NodeParameters, own: Mapping[str, type] | None = None
) -> BridgeParameters:
    """Declare the parameters of the bridge.

    Args:
        node: the node.
        parameters: its parameters.
        own: dataclasses of further parameters of a derived node, by their prefix; read-only.

    Raises:
        FiberError: a value is refused.
    """
    declared = BridgeParameters(
        declare_hardware(parameters),
        parameters.declare(Safety, "safety", read_only=True).value,
        parameters.declare(BlindErrors, read_only=True).value,
        parameters.declare(ExecutionConfig, read_only=True).value,
        parameters.declare(AttemptConfig),
        parameters.declare(StartConfig, effect="for the next call of the service start"),
        parameters.declare(SessionConfig, "session", read_only=True).value,
        parameters.declare(MemoryConfig, read_only=True).value,
        declare_disabled(node, parameters),
        {
            prefix: parameters.declare(config, prefix, read_only=True).value
            for prefix, config in (own or {}).items()
        },
    )
    declare_vouched(node, parameters)
    parameters.finish()
    return declared
