# SPDX-License-Identifier: Apache-2.0
"""The parameter by which operators vouch for the places of robots that do not answer."""

from collections.abc import Callable, Iterable

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from fiber_bus_bridge.node.disabled_parameter import ids_of
from fiber_core.errors import FiberError
from fiber_node import NodeParameters

__all__ = ["declare_vouched", "follow_vouched_parameter"]

_ABOUT = (
    "Ids of robots that do not answer and rest where they were read last, or assumed, as an "
    "operator has seen; a change is in effect at once, and is refused while robots move."
)


def declare_vouched(node: Node, parameters: NodeParameters) -> None:
    """Declare the parameter `vouched`, at first without robots.

    A dump of a bridge can have robots of its time, for which nothing vouches now: they are refused.
    """
    given = parameters.take("vouched")
    if given:
        node.get_logger().warning(
            f"vouched is {list(given)} at the start and has no effect: vouch for robots while the "
            "bridge runs, when you have seen that they rest"
        )
    # dynamic typing: an empty list has no element type
    about = ParameterDescriptor(description=_ABOUT, dynamic_typing=True)
    node.declare_parameter("vouched", None, about, ignore_override=True)
    node.set_parameters([Parameter("vouched", Parameter.Type.INTEGER_ARRAY, [])])


def follow_vouched_parameter(
    node: Node, vouch: Callable[[list[int]], None], refuse: Callable[[str], None]
) -> None:
    """Vouch for the robots of each later value.

    Args:
        node: the node with the parameter.
        vouch: called with the ids; refuses by raising a FiberError.
        refuse: called with the text of a refusal.
    """

    def on_set(parameters: Iterable[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name != "vouched":
                continue
            try:
                vouch(ids_of(parameter.value, "vouched"))
            except FiberError as error:
                refuse(str(error))
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)
