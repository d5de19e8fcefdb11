"""The fields of a dataclass as parameters of a node."""

from dataclasses import MISSING, Field, fields
from typing import Any, ClassVar, Protocol, TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

__all__ = ["declare_parameters"]

_PLAIN = (bool, int, float, str)


class _Dataclass(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


_Config = TypeVar("_Config", bound=_Dataclass)


def declare_parameters(node: Node, config_class: type[_Config], prefix: str = "") -> _Config:
    """Declare the fields of a dataclass as parameters; return the dataclass with their values.

    The dataclass owns the defaults and checks the ranges. A field with the default None is
    declared without a value; a field with neither a plain value nor None keeps its default.

    Args:
        node: the node that gets the parameters.
        config_class: the dataclass.
        prefix: put before the name of each field, with a dot.

    Raises:
        FiberError: a value is out of range, as the dataclass decides.
        rclpy.exceptions.InvalidParameterTypeException: a value is of the wrong type.
    """
    given = {}
    for field in fields(config_class):
        default = None if field.default is MISSING else field.default
        if field.default is MISSING or not (default is None or isinstance(default, _PLAIN)):
            continue
        name = f"{prefix}.{field.name}" if prefix else field.name
        about = ParameterDescriptor(description=str(field.type), dynamic_typing=default is None)
        value = node.declare_parameter(name, default, about).value
        if value is not None:
            given[field.name] = value
    return config_class(**given)
