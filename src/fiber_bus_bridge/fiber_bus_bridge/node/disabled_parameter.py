"""The parameters by which operators take robots out of use, and put them back."""

from collections.abc import Callable
from pathlib import Path

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from fiber_bus_bridge.availability import Availability
from fiber_bus_bridge.errors import BridgeError
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane

__all__ = ["declare_availability", "follow_operators"]


def declare_availability(node: Node, plane: FocalPlane) -> Availability:
    """Declare `disabled`, `disabled_why` and `disabled_file`; return the roster they make.

    The file of the list stands before the parameter `disabled`, which shows it.

    Raises:
        BridgeError: the list cannot be read, or names a robot that the plane does not have.
    """
    file = node.declare_parameter("disabled_file", "").value
    why = node.declare_parameter("disabled_why", "").value
    # of any type: a list without members has none of its own
    about = ParameterDescriptor(description="ids of robots taken out", dynamic_typing=True)
    given = node.declare_parameter("disabled", None, about).value
    roster = Availability(plane, Path(file) if file else None)
    if not file:
        roster.disable(_ids(given), why)
    shown = Parameter("disabled", Parameter.Type.INTEGER_ARRAY, sorted(roster.disabled))
    node.set_parameters([shown])
    return roster


def follow_operators(
    node: Node, change: Callable[[list[int], str], None], refuse: Callable[[str], None]
) -> None:
    """Pass on what is set from now on; what is refused stays as it was.

    Args:
        node: the node with the parameters.
        change: called with the whole list and the reason for who is new on it; refuses by raising
            a FiberError.
        refuse: told why something was refused.
    """

    def on_set(parameters):
        named = {parameter.name: parameter.value for parameter in parameters}
        if "disabled" not in named:
            return SetParametersResult(successful=True)
        why = named.get("disabled_why", node.get_parameter("disabled_why").value)
        try:
            change(_ids(named["disabled"]), why)
        except FiberError as error:
            refuse(str(error))
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)


def _ids(value) -> list[int]:
    value = [] if value is None else value
    if isinstance(value, (str, bytes)) or not hasattr(value, "__iter__"):
        raise BridgeError(f"disabled is {value!r}, expected robot ids")
    for entry in value:
        if type(entry) is not int:
            raise BridgeError(f"disabled holds {entry!r}, expected robot ids")
    return list(value)
