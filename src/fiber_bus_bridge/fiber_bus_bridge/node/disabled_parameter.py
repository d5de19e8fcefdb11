# SPDX-License-Identifier: Apache-2.0
"""The parameters by which operators disable and enable robots."""

import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from fiber_bus_bridge.availability import Availability
from fiber_bus_bridge.errors import BridgeError
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_node import NodeParameters

__all__ = ["DisabledParameters", "declare_disabled", "follow_disabled_parameter", "ids_of"]


@dataclass(frozen=True)
class _ListFile:
    """Where the list of disabled robots is kept.

    Args:
        disabled_file: YAML file that keeps the list of disabled robots over restarts and overrides
            the parameter disabled; an empty text for a list in memory only.
    """

    disabled_file: str = ""


@dataclass(frozen=True)
class _Why:
    """Why operators disable robots.

    Args:
        disabled_why: reason recorded for robots that are new on the list; set it together with
            disabled.
    """

    disabled_why: str = ""


_ABOUT = (
    "Ids of the robots that operators have disabled; a change is in effect at once, and is refused "
    "while a plan is under way."
)


@dataclass
class DisabledParameters:
    """The parameters `disabled`, `disabled_why` and `disabled_file` of a node.

    Args:
        node: the node.
        given: the list that operators gave last, None for none.
        reason: the reason that was given with it.
        file: the file of the list, empty without one.
        shown_by: the thread that shows the list in the parameter, while it does; not a change.
    """

    node: Node
    given: Any
    reason: str
    file: str
    shown_by: int | None = None

    def availability(self, plane: FocalPlane, memory: Path | None = None) -> Availability:
        """Return the availability of the robots, and show their list in the parameter.

        With a file the list comes from the file.

        Args:
            plane: the focal plane.
            memory: file with the memory of the robots, beside which the list is kept if
                `disabled_file` is not set; None to keep it in memory only. There, `disabled`
                overrides the list.

        Raises:
            BridgeError: the list cannot be read, or names a robot that the plane does not have.
        """
        beside = None if memory is None else memory.with_name(f"{memory.stem}-disabled.yaml")
        availability = Availability(plane, Path(self.file) if self.file else beside)
        if not self.file and (self.given is not None or beside is None):
            availability.disable(ids_of(self.given, "disabled"), self.reason)
        ids = sorted(availability.disabled)
        self.shown_by = threading.get_ident()
        self.node.set_parameters([Parameter("disabled", Parameter.Type.INTEGER_ARRAY, ids)])
        self.given, self.shown_by = ids, None
        return availability

    def keep(self, ids: Iterable[int], reason: str) -> None:
        """Keep the list that operators gave last, with its reason, for the next configuration."""
        self.given, self.reason = list(ids), reason


def declare_disabled(node: Node, parameters: NodeParameters) -> DisabledParameters:
    """Declare `disabled`, `disabled_why` and `disabled_file`."""
    file = parameters.declare(_ListFile, read_only=True).value.disabled_file
    reason = parameters.declare(_Why).value.disabled_why
    given = parameters.take("disabled")
    # dynamic typing: an empty list has no element type
    about = ParameterDescriptor(description=_ABOUT, dynamic_typing=True)
    node.declare_parameter("disabled", None, about, ignore_override=True)
    shown = Parameter("disabled", Parameter.Type.INTEGER_ARRAY, ids_of(given, "disabled"))
    node.set_parameters([shown])
    return DisabledParameters(node, given, reason, file)


def follow_disabled_parameter(
    declared: DisabledParameters,
    change: Callable[[list[int], str], None],
    refuse: Callable[[str], None],
) -> None:
    """Apply later changes of the parameter; a refused change leaves the parameter as it was.

    Args:
        declared: the parameters.
        change: called with the complete list and the reason of the robots that are new on the
            list; refuses by raising a FiberError.
        refuse: called with the text of a refusal.
    """
    node = declared.node

    def on_set(parameters: Iterable[Parameter]) -> SetParametersResult:
        named = {parameter.name: parameter.value for parameter in parameters}
        if "disabled" not in named or declared.shown_by == threading.get_ident():
            return SetParametersResult(successful=True)
        reason = named.get("disabled_why", node.get_parameter("disabled_why").value)
        try:
            change(ids_of(named["disabled"], "disabled"), str(reason))
        except FiberError as error:
            refuse(str(error))
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(on_set)


def ids_of(value: object, name: str) -> list[int]:
    """Return the robot ids in the value of a parameter.

    Raises:
        BridgeError: the value is no list of ids.
    """
    value = [] if value is None else value
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        raise BridgeError(f"{name} is {value!r}, expected robot ids")
    ids = list(value)
    for entry in ids:
        if type(entry) is not int:
            raise BridgeError(f"{name} holds {entry!r}, expected robot ids")
    return ids
