# SPDX-License-Identifier: Apache-2.0
"""The parameters of a node, declared from the dataclasses of its core."""

import difflib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, Field, fields
from inspect import getdoc
from math import inf, isinf
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from fiber_core.errors import FiberError

__all__ = ["Declared", "NodeParameters", "ParameterError", "descriptions"]

_OF_ROS = ("use_sim_time", "start_type_description_service", "qos_overrides")
_MOST_INTEGER = 2**63 - 1
_UNSET = 0.0  # stands for None, and for a default of inf: a dump then loads with every tool


class ParameterError(FiberError):
    """A parameter has a value that its node cannot use; the text names both."""


class _Dataclass(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


_Config = TypeVar("_Config", bound=_Dataclass)


class _Entry(NamedTuple):
    """A field of a dataclass as a parameter: its default and how its values are encoded."""

    field: str
    default: Any  # in the dataclass
    declared: Any  # the default as a value of the parameter

    @property
    def is_float(self) -> bool:
        return isinstance(self.declared, float)

    def decode(self, value: Any) -> Any:
        """Return the value of the field for a value of the parameter."""
        if self.is_float and value == _UNSET and self.default in (None, inf):
            return self.default
        if isinstance(self.declared, list):
            kind = type(self.declared[0])
            return tuple(kind(each) for each in value if each != "")
        return value

    def coerce(self, value: Any, name: str) -> Any:
        """Return a value given at the start with the type of the parameter.

        Raises:
            ParameterError: it has another type; a whole number serves for a number.
        """
        if value is None:  # an empty list in a parameter file has no type
            return self.declared
        if self.is_float and type(value) is int:
            return float(value)
        if isinstance(self.declared, list):
            value = list(value) if not isinstance(value, (str, bytes)) and _many(value) else value
            if isinstance(value, list) and all(type(v) is type(self.declared[0]) for v in value):
                return value or self.declared
        elif type(value) is type(self.declared):
            return value
        kind = f"a list like {self.declared}" if isinstance(self.declared, list) else _kind(self)
        raise ParameterError(f"parameter {name} is {value!r}, expected {kind}")


class Declared(Generic[_Config]):
    """The parameters of one dataclass on a node.

    Args:
        config_class: the dataclass.
        prefix: put before the name of each field, with a dot.
        read_only: whether the parameters cannot be set while the node runs.
        effect: when a change is in effect, for the log.
        entries: field and encoding of each parameter by its name.
        value: the dataclass with the values that are in effect.
    """

    def __init__(
        self,
        config_class: type[_Config],
        prefix: str,
        read_only: bool,
        effect: str,
        entries: Mapping[str, _Entry],
        value: _Config,
    ):
        self.config_class, self.prefix = config_class, prefix
        self.read_only, self.effect = read_only, effect
        self.entries, self.value = entries, value

    def with_values(self, values: Mapping[str, Any]) -> _Config:
        """Return the dataclass for values of the parameters, by name.

        Raises:
            FiberError: the dataclass refuses a value.
        """
        given = {
            entry.field: entry.decode(values[name])
            for name, entry in self.entries.items()
            if name in values
        }
        return self.config_class(**given)


class NodeParameters:
    """Declares parameters on a node, checks every change, and keeps what is in effect.

    The dataclass of a core owns names, defaults and checks. Its `RANGES` and `CHOICES`, if it has
    them, become the ranges of the descriptors, and the `Args` of its docstring the descriptions.
    A parameter is read-only, or a change is checked by the dataclass and is in effect from the
    next plan on, with a line in the log. A default None or inf is declared as 0.0.

    Args:
        node: the node.
    """

    def __init__(self, node: Node):
        self._node = node
        self._groups: list[Declared[Any]] = []
        self._others: set[str] = set()

    def declare(
        self,
        config_class: type[_Config],
        prefix: str = "",
        read_only: bool = False,
        effect: str = "from the next plan",
    ) -> Declared[_Config]:
        """Declare the fields of a dataclass; return them with the values that were given.

        A field that is no number, text, boolean or list of one of these keeps its default.

        Args:
            config_class: the dataclass.
            prefix: put before the name of each field, with a dot.
            read_only: whether the parameters cannot be set while the node runs.
            effect: when a change is in effect, for the log.

        Raises:
            FiberError: a value is of the wrong type, or the dataclass refuses it.
        """
        about = descriptions(config_class)
        entries, values = {}, {}
        for entry in _entries(config_class):
            name = f"{prefix}.{entry.field}" if prefix else entry.field
            entries[name] = entry
            values[name] = entry.coerce(self._given(name), name)
        declared = Declared(config_class, prefix, read_only, effect, entries, config_class())
        declared.value = declared.with_values(values)
        for name, entry in entries.items():
            descriptor = _descriptor(config_class, entry, about.get(entry.field, ""), read_only)
            self._node.declare_parameter(name, values[name], descriptor, ignore_override=True)
        self._groups.append(declared)
        return declared

    def take(self, name: str) -> Any:
        """Return the value that a parameter was given at the start, or None.

        The node itself declares this parameter afterwards, because no dataclass describes it.
        """
        self._others.add(name)
        return self._given(name)

    @property
    def defaults(self) -> dict[str, Any]:
        """The default of each parameter that a dataclass describes, by name, as ROS has it."""
        return {
            name: entry.declared for group in self._groups for name, entry in group.entries.items()
        }

    def finish(self) -> None:
        """Check changes from now on; log the settings, and given parameters that do not exist."""
        self._node.add_pre_set_parameters_callback(self._with_numbers)
        self._node.add_on_set_parameters_callback(self._check)
        self._node.add_post_set_parameters_callback(self._put_into_effect)
        self._name_unknown()
        changed = ", ".join(self._changed())
        self._node.get_logger().info(f"settings: {changed or 'all parameters have their defaults'}")

    def _given(self, name: str) -> Any:
        # the value given at the start; PlaneNode has declared it, with the type that it has
        if not self._node.has_parameter(name):
            return None
        value = self._node.get_parameter(name).value
        self._node.undeclare_parameter(name)
        return value

    def missing(self, name: str) -> str:
        """Return what to say of a parameter that does not exist, with the nearest that do."""
        known = sorted(self._known())
        like = [each for each in known if each.split(".")[-1] == name.split(".")[-1]]
        like = like or difflib.get_close_matches(name, known, n=1)
        hint = f"; did you mean {' or '.join(like)}?" if like else ""
        return f"parameter {name} does not exist and has no effect{hint}"

    def _known(self) -> set[str]:
        return {name for group in self._groups for name in group.entries} | self._others

    def _name_unknown(self) -> None:
        for name in sorted(set(self._node.get_parameters_by_prefix("")) - self._known()):
            if name.split(".")[0] in _OF_ROS:
                continue
            self._node.get_logger().warning(self.missing(name))
            self._node.undeclare_parameter(name)

    def _changed(self) -> Iterator[str]:
        for group in self._groups:
            for name, entry in group.entries.items():
                value = self._node.get_parameter(name).value
                if _plain(value) != entry.declared:
                    yield f"{name} = {_plain(value)!r}"

    def _with_numbers(self, parameters: list[Parameter]) -> list[Parameter]:
        # a whole number serves for a number, as `ros2 param set planner dnf.lambda1 2`, and so does
        # 1e-5, which YAML takes for a text: `ros2 param load` writes small numbers so
        entries = {name: entry for group in self._groups for name, entry in group.entries.items()}
        converted = []
        for each in parameters:
            number = _number(each.value)
            if number is not None and each.name in entries and entries[each.name].is_float:
                each = Parameter(each.name, Parameter.Type.DOUBLE, number)
            converted.append(each)
        return converted

    def _touched(
        self, parameters: Iterable[Parameter]
    ) -> Iterator[tuple[Declared[Any], dict[str, Any]]]:
        # each group with a change, and the values of its parameters with the changes
        new = {each.name: each.value for each in parameters}
        for group in self._groups:
            if not group.read_only and new.keys() & group.entries.keys():
                values = {name: self._node.get_parameter(name).value for name in group.entries}
                yield group, values | {n: v for n, v in new.items() if n in group.entries}

    def _check(self, parameters: list[Parameter]) -> SetParametersResult:
        for group, values in self._touched(parameters):
            try:
                group.with_values(values)
            except FiberError as error:
                self._node.get_logger().warning(f"parameter change refused: {error}")
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _put_into_effect(self, parameters: list[Parameter]) -> None:
        for group, values in self._touched(parameters):
            before, group.value = group.value, group.with_values(values)
            for each in parameters:
                entry = group.entries.get(each.name)
                if entry and getattr(before, entry.field) != getattr(group.value, entry.field):
                    self._node.get_logger().info(
                        f"parameter {each.name} is now {_plain(each.value)!r}, "
                        f"in effect {group.effect}"
                    )


def descriptions(config_class: type) -> dict[str, str]:
    """Return a sentence about each field of a dataclass, from the `Args` of its docstring.

    Args:
        config_class: the dataclass; the docstrings of its bases count too.
    """
    found: dict[str, str] = {}
    for each in reversed(config_class.__mro__):
        section = re.search(r"\nArgs:\n(.*?)(?:\n\S|\Z)", getdoc(each) or "", re.DOTALL)
        if section is None or each.__doc__ is None:
            continue
        for entry in re.split(r"\n(?=    \w)", "\n" + section.group(1)):
            names, colon, text = entry.strip().partition(": ")
            sentence = " ".join(text.split())
            if colon and sentence:
                sentence = sentence[0].upper() + sentence[1:].rstrip(".") + "."
                found |= {name.strip(): sentence for name in names.split(",")}
    return found


def _entries(config_class: type[_Dataclass]) -> Iterator[_Entry]:
    for field in fields(config_class):
        default = field.default
        if default is MISSING:
            continue
        if default is None or (isinstance(default, float) and isinf(default)):
            yield _Entry(field.name, default, _UNSET)
        elif isinstance(default, (bool, int, float, str)):
            yield _Entry(field.name, default, default)
        elif isinstance(default, tuple) and default:
            yield _Entry(field.name, default, list(default))


def _descriptor(
    config_class: type, entry: _Entry, about: str, read_only: bool
) -> ParameterDescriptor:
    if entry.default is None:
        about += " 0.0 stands for None."
    elif entry.is_float and isinf(entry.default):
        about += " 0.0 stands for no limit."
    descriptor = ParameterDescriptor(description=about, read_only=read_only)
    bounds = getattr(config_class, "RANGES", {}).get(entry.field)
    if bounds is not None and entry.is_float:
        low = min(bounds.low, _UNSET) if entry.default is None else bounds.low
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(low), to_value=float(bounds.high))
        ]
    elif bounds is not None:
        most = min(int(bounds.high), _MOST_INTEGER)
        descriptor.integer_range = [IntegerRange(from_value=int(bounds.low), to_value=most)]
    choices = getattr(config_class, "CHOICES", {}).get(entry.field)
    if choices is not None:
        descriptor.additional_constraints = f"one of {', '.join(map(str, choices))}"
    return descriptor


def _number(value: Any) -> float | None:
    """Return the number that a whole number or a text stands for, or None."""
    if type(value) not in (int, str):
        return None
    try:
        return float(value)
    except ValueError:
        return None


def _many(value: Any) -> bool:
    return isinstance(value, Iterable)


def _plain(value: Any) -> Any:
    return list(value) if _many(value) and not isinstance(value, (str, bytes)) else value


def _kind(entry: _Entry) -> str:
    kinds: dict[type, str] = {bool: "true or false", int: "a whole number", str: "a text"}
    return kinds.get(type(entry.declared), "a number")
