#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Write the topics, services, actions and parameters of all nodes into docs/interfaces.md.

Between two marker lines of that page stand the tables; this command makes them anew from nodes that
it starts in a domain of their own, or with --check says whether they are up to date. The gateway
is read from the files of its interfaces, so that it is there without a compiler too.
"""

import argparse
import os
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path += [str(path) for path in sorted((ROOT / "src").glob("fiber_*"))]

import rclpy  # noqa: E402
from rcl_interfaces.msg import ParameterDescriptor  # noqa: E402
from rclpy.context import Context  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy  # noqa: E402

from fiber_bus_bridge.node import BridgeNode  # noqa: E402
from fiber_client.robot_model import DESCRIPTION, RobotModelNode  # noqa: E402
from fiber_console.node import ConsoleNode  # noqa: E402
from fiber_discretizer.node import DiscretizerNode  # noqa: E402
from fiber_metrology.camera.node import CameraNode  # noqa: E402
from fiber_metrology.node import MetrologyNode  # noqa: E402
from fiber_msgs_py import topics  # noqa: E402
from fiber_msgs_py.topics import Service, Topic  # noqa: E402
from fiber_node import PlaneNode  # noqa: E402
from fiber_node.ros_environment import own_domain, use_loopback  # noqa: E402
from fiber_planner.node import PlannerNode  # noqa: E402
from fiber_recording.node import RecorderNode  # noqa: E402
from fiber_sectors.node import SectorNode  # noqa: E402
from fiber_viewer.node import WATCHED, ViewerNode  # noqa: E402

__all__ = ["actions_and_services", "all_nodes", "fresh", "main"]

PAGE = ROOT / "docs" / "interfaces.md"
BEGIN, END = "<!-- begin: tools/interfaces.py -->", "<!-- end: tools/interfaces.py -->"
TYPED = ROOT / "src" / "fiber_interfaces"

_NODES = (
    PlannerNode, DiscretizerNode, BridgeNode, RecorderNode, ViewerNode, ConsoleNode,
    MetrologyNode, CameraNode, RobotModelNode, SectorNode,
)  # fmt: skip
_GIVEN = {"bridge": {"robots": 7}, "sector": {"robots": 7}}  # as quick as possible
# A coordinator is a bridge that waits for its sectors, which no node does here.
_BY_COORDINATOR = {"from": topics.TO_SECTOR, "to": topics.FROM_SECTOR}
_OF_ROS = ("use_sim_time", "start_type_description_service")
_TOPICS = [each for each in vars(topics).values() if isinstance(each, Topic)]
_TOPICS += [WATCHED, DESCRIPTION]
_SERVICES = [each for each in vars(topics).values() if isinstance(each, Service)]


def fresh(text: str, domain: int) -> str:
    """Return the text of the page with the tables made anew.

    Args:
        text: the page as it is.
        domain: ROS domain without other nodes.
    """
    with all_nodes(domain) as nodes:
        body = "\n".join(_page(nodes))
    head, rest = text.split(BEGIN)
    return f"{head}{BEGIN}\n{body}\n{END}{rest.split(END)[1]}"


@contextmanager
def all_nodes(domain: int) -> Iterator[list[PlaneNode]]:
    """Start all nodes but the gateway in a domain; they end with the context."""
    context, nodes = Context(), []
    rclpy.init(args=[], context=context, domain_id=domain)
    try:
        for make in _NODES:
            name = make.__name__.removesuffix("Node").lower()
            given = [Parameter(n, value=value) for n, value in _GIVEN.get(name, {}).items()]
            nodes.append(make(context=context, parameter_overrides=given))
        yield nodes
    finally:
        for node in nodes:
            node.destroy_node()
        context.try_shutdown()


def _page(nodes: Sequence[PlaneNode]) -> Iterator[str]:
    names = {each.get_name(): each for each in nodes}
    yield "## Topics\n"
    yield "| topic | type | latched, depth | from | to | content |\n|---|---|---|---|---|---|"
    for topic in sorted(_TOPICS, key=lambda each: each.name):
        latched = "yes" if topic.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL else "no"
        senders = [n for n, node in names.items() if _has(node.publishers, topic.name)]
        receivers = [n for n, node in names.items() if _has(node.subscriptions, topic.name)]
        senders += ["coordinator"] * (topic is _BY_COORDINATOR["from"])
        receivers += ["coordinator"] * (topic is _BY_COORDINATOR["to"])
        yield (
            f"| `{topic.name}` | {topic.type.__name__} | {latched}, {topic.qos.depth} "
            f"| {', '.join(senders)} | {', '.join(receivers)} | {topic.about} |"
        )
    yield "\n## Services\n"
    yield "| service | type | node | effect |\n|---|---|---|---|"
    for service in sorted(_SERVICES, key=lambda each: each.name):
        (server,) = (
            n for n, node in names.items() if any(_ends(s.srv_name, service) for s in node.services)
        )
        yield f"| `{service.name}` | {service.type.__name__} | {server} | {service.about} |"
    yield from _typed()
    for name, node in names.items():
        yield f"\n## Parameters of `{name}`\n"
        yield "| parameter | type | default | from, to | changes | meaning |"
        yield "|---|---|---|---|---|---|"
        yield from _parameters(node)


def _has(endpoints: Iterator[Any], topic: str) -> bool:
    return any(each.topic_name.lstrip("/") == topic.lstrip("/") for each in endpoints)


def _ends(name: str, service: Service) -> bool:
    return name.lstrip("/") == service.name


def _parameters(node: PlaneNode) -> Iterator[str]:
    defaults = node.parameters.defaults
    for name in sorted(node.get_parameters_by_prefix("")):
        if name in _OF_ROS:
            continue
        about, parameter = node.describe_parameter(name), node.get_parameter(name)
        value = defaults.get(name, _plain(parameter.value))
        kind = parameter.type_.name.lower().replace("_array", "[]")
        changes = "at the start" if about.read_only else "yes"
        meaning = " ".join(filter(None, (about.description, _choices(about))))
        yield f"| `{name}` | {kind} | {_shown(value)} | {_range(about)} | {changes} | {meaning} |"


def _plain(value: Any) -> Any:
    return value if isinstance(value, (str, int, float)) else list(value)


def _shown(value: Any) -> str:
    text = f"{value:g}" if isinstance(value, float) else str(value).lower()
    if isinstance(value, str):
        return f"`{value}`" if value else ""
    return text if not isinstance(value, list) else f"`{value}`"


def _range(about: ParameterDescriptor) -> str:
    ranges = [*about.floating_point_range, *about.integer_range]
    return ", ".join(f"{each.from_value:g}, {each.to_value:g}" for each in ranges)


def _choices(about: ParameterDescriptor) -> str:
    text = about.additional_constraints
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _typed() -> Iterator[str]:
    yield "\n## Action and service of `gateway`\n"
    yield "Types of the package `fiber_interfaces`, which is built where a compiler is.\n"
    yield "| name | type | field | type of the field | meaning |\n|---|---|---|---|---|"
    for name, (kind, parts) in actions_and_services().items():
        for part, fields in parts.items():
            for field, (of, about) in fields.items():
                yield f"| `{name}` | {kind} | {part}: `{field}` | {of} | {about} |"


def actions_and_services() -> dict[str, tuple[str, Mapping[str, dict[str, tuple[str, str]]]]]:
    """Return type and fields of the typed interfaces by name, as their files say.

    The fields are in parts, such as goal, result and feedback, by name, with type and comment.
    """
    return {
        f"{topics.NAMESPACE}/{name}": (
            path.stem,
            dict(
                zip(parts, map(_fields, re.split(r"^---$", path.read_text(), flags=re.MULTILINE)))
            ),
        )
        for name, path, parts in (
            ("reconfigure", TYPED / "action/Reconfigure.action", ("goal", "result", "feedback")),
            ("start_plan", TYPED / "srv/Start.srv", ("request", "response")),
        )
    }


def _fields(text: str) -> dict[str, tuple[str, str]]:
    found = {}
    for line in text.splitlines():
        declared, _, comment = line.partition("#")
        if declared.strip() and "=" not in declared:
            kind, name, *default = declared.split()
            default = f" Default {default[0]}." if default else ""
            found[name] = kind, (comment.strip() + default).replace("|", "\\|")
    return found


def main(argv: list[str] | None = None) -> int:
    """Write the page, or check it; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; 1 if it is stale")
    options = parser.parse_args(argv)
    use_loopback()
    os.environ.pop("ROS_NAMESPACE", None)
    text = PAGE.read_text(encoding="utf-8")
    new = fresh(text, own_domain())
    if options.check:
        if new != text:
            print(f"{PAGE} is stale: run tools/interfaces.py", file=sys.stderr)
        return int(new != text)
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
