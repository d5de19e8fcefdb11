# SPDX-License-Identifier: Apache-2.0
"""Sections of parameter files that apply to no node, which ROS passes over in silence."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import yaml
from rclpy.node import Node

__all__ = ["section_warnings", "warn_of_sections"]

_OPTION = "--params-file"
_NODES = (
    "bridge", "camera", "console", "discretizer", "gateway", "metrology", "planner", "plant",
    "recorder", "robot_model", "sector", "viewer",
)  # fmt: skip
_PARAMETERS = "ros__parameters"


def warn_of_sections(node: Node, arguments: Sequence[str]) -> None:
    """Warn of sections of parameter files that do not apply to a node.

    Args:
        node: the node.
        arguments: its command line.
    """
    for line in section_warnings(arguments, node.get_fully_qualified_name()):
        node.get_logger().warning(line)


def section_warnings(arguments: Sequence[str], node: str) -> list[str]:
    """Return a line for each section that means no node, or this one and does not apply to it.

    Args:
        arguments: the command line of the node.
        node: its name with its namespace, as /north/bridge.
    """
    files = [arguments[at + 1] for at, each in enumerate(arguments[:-1]) if each == _OPTION]
    return [line for file in files for line in _of_file(file, node)]


def _of_file(file: str, node: str) -> Iterator[str]:
    try:
        content = yaml.safe_load(Path(file).read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError):
        return  # rcl has refused it
    own = node.rpartition("/")[2]
    for section in _sections(content, ""):
        last = section.rpartition("/")[2]
        if _matches(section, node) or "*" in last:
            continue
        if last == own:
            yield (
                f"section {section.lstrip('/')} of {file} does not apply to {node}: "
                f"write {node} or /**/{own}"
            )
        elif last not in _NODES:
            yield f"section {section.lstrip('/')} of {file} names no node of the graph"


def _sections(content: Any, path: str) -> Iterator[str]:
    # names may be nested: a namespace, and nodes in it
    if not isinstance(content, dict):
        return
    for name, inner in content.items():
        if name == _PARAMETERS:
            yield path
        else:
            yield from _sections(inner, f"{path}/{str(name).strip('/')}")


def _matches(section: str, node: str) -> bool:
    parts = {"**": r"(?:/\w+)*", "*": r"/\w+"}
    tokens = section.strip("/").split("/")
    pattern = "".join(parts.get(each, "/" + re.escape(each)) for each in tokens)
    return re.fullmatch(pattern, node) is not None
