"""Settings of a core, declared as the parameters of a node."""

from dataclasses import MISSING, fields
from typing import TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

__all__ = ["declare_parameters_of"]

_Settings = TypeVar("_Settings")
_PLAIN = (bool, int, float, str)


def declare_parameters_of(node: Node, settings: type[_Settings], prefix: str = "") -> _Settings:
    """Declare the fields of a settings dataclass as parameters and return what was set.

    The dataclass owns the defaults and checks the ranges. A field whose default is None is
    declared without a value; fields that are neither plain values nor None stay as they are.

    Args:
        node: whose parameters.
        settings: the dataclass.
        prefix: put before each field's name, with a dot.

    Raises:
        FiberError: a value is out of range, as the dataclass decides.
        rclpy.exceptions.InvalidParameterTypeException: a value is of the wrong type.
    """
    given = {}
    for field in fields(settings):
        default = None if field.default is MISSING else field.default
        if field.default is MISSING or not (default is None or isinstance(default, _PLAIN)):
            continue
        name = f"{prefix}.{field.name}" if prefix else field.name
        about = ParameterDescriptor(description=str(field.type), dynamic_typing=default is None)
        value = node.declare_parameter(name, default, about).value
        if value is not None:
            given[field.name] = value
    return settings(**given)
