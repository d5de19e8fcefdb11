#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Write the SROS 2 policy of all nodes from what they declare.

The policy says for each enclave what its nodes may publish, hear, serve and call, and nothing else.
This command starts the nodes in a domain of their own and writes
src/fiber_bringup/config/security_policy.xml anew, or with --check says whether it is up to date.
"""

import argparse
import os
import re
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeAlias

ROOT = Path(__file__).parents[1]
sys.path += [str(ROOT / "tools"), *(str(path) for path in sorted((ROOT / "src").glob("fiber_*")))]

from interfaces import all_nodes  # noqa: E402
from rclpy.node import Node  # noqa: E402

from fiber_client import PlaneClient  # noqa: E402
from fiber_msgs_py import topics  # noqa: E402
from fiber_msgs_py.topics import Service  # noqa: E402
from fiber_node import BRIDGE, DISCRETIZER, PLANNER  # noqa: E402
from fiber_node.ros_environment import own_domain, use_loopback  # noqa: E402

__all__ = ["POLICY", "main", "policy"]

POLICY = ROOT / "src" / "fiber_bringup" / "config" / "security_policy.xml"
_ABOUT = """
What each node may do, as SROS 2 reads it. Made by tools/security.py from what the nodes declare;
docs/network.md says how it is used. operator: clients that send targets and call services;
monitor: clients that only hear. Names are those of a plane without a namespace.
"""

_Rights: TypeAlias = dict[tuple[str, str, str], set[str]]  # (group, right, kind): names
_OF_ALL: _Rights = {
    ("topics", "publish", "topic"): {"rosout", "parameter_events"},
    ("topics", "subscribe", "topic"): {
        "clock",
        "parameter_events",
        # signs of life of those that claim a role
        *(f"{topics.NAMESPACE}/_{role}_alive_session_*" for role in (BRIDGE, PLANNER, DISCRETIZER)),
    },
}
_PARAMETERS = (
    "describe_parameters", "get_parameter_types", "get_parameters", "list_parameters",
    "set_parameters", "set_parameters_atomically",
)  # fmt: skip
_CLAIM = re.compile(r"(focal_plane/_[a-z_]+_session_)\w+")
_SERVICES = {each.name for each in vars(topics).values() if isinstance(each, Service)}


def policy(domain: int) -> str:
    """Return the policy, as XML.

    Args:
        domain: ROS domain without other nodes.
    """
    with all_nodes(domain) as started, PlaneClient(domain, args=[]) as client:
        rights = {node.get_name(): _declared(node) for node in started}
        hears = _declared(client._ros.node)
    for name, own in rights.items():  # of managed nodes, made below rclpy
        if f"{name}/change_state" in own["services", "reply", "service"]:
            own["topics", "publish", "topic"].add(f"{name}/transition_event")
    topic = ("topics", "subscribe", "topic")
    rights["viewer"][topic].add(topics.JOINT_STATES.name)  # while it has subscribers itself
    request, of_bridge = ("services", "request", "service"), {f"bridge/{p}" for p in _PARAMETERS}
    orders = hears | {request: _SERVICES | of_bridge}
    # the console has clients of the services, and asks for parameters only when a browser does
    rights["console"][request] |= of_bridge
    rights["metrology"][topic].add(topics.IMAGE.name)  # where it finds spots in pixels itself
    gateway = {
        ("actions", "execute", "action"): {"focal_plane/reconfigure"},
        ("services", "reply", "service"): {
            "focal_plane/start_plan", *(f"gateway/{each}" for each in _PARAMETERS),
        },
    }  # fmt: skip
    # of a bridge that coordinates sectors, each in a namespace of its own
    links = {
        ("topics", "publish", "topic"): {f"sector_*/{topics.TO_SECTOR.name}"},
        topic: {f"sector_*/{topics.FROM_SECTOR.name}"},
    }
    root = ET.Element("policy", version="0.2.0")
    root.append(ET.Comment(_ABOUT))
    enclaves = ET.SubElement(root, "enclaves")
    for name, own in sorted(rights.items()):
        nodes = {name: own, "bridge_links": links} if name == "bridge" else {name: own}
        _enclave(enclaves, name, nodes)
    _enclave(enclaves, "gateway", {"gateway": gateway, "plane_client": orders})
    _enclave(enclaves, "operator", {"plane_client": orders})
    _enclave(enclaves, "monitor", {"plane_client": {topic: hears[topic]}})
    ET.indent(root, "  ")
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _declared(node: Node) -> _Rights:
    """What a node has declared."""
    return {
        ("topics", "publish", "topic"): _names(each.topic_name for each in node.publishers),
        ("topics", "subscribe", "topic"): _names(each.topic_name for each in node.subscriptions),
        ("services", "reply", "service"): _names(each.srv_name for each in node.services),
        ("services", "request", "service"): _names(each.srv_name for each in node.clients),
    }


def _names(names: Iterable[str]) -> set[str]:
    """Names without the first slash; claims have an id in their names."""
    return {_CLAIM.sub(r"\1*", name.lstrip("/")) for name in names}


def _enclave(parent: ET.Element, name: str, nodes: dict[str, _Rights]) -> None:
    enclave = ET.SubElement(parent, "enclave", path=f"/focal_plane/{name}")
    profiles = ET.SubElement(enclave, "profiles")
    for node, rights in nodes.items():
        profile = ET.SubElement(profiles, "profile", ns="/", node=node)
        for key in sorted({*rights, *_OF_ALL}):
            allowed = rights.get(key, set()) | _OF_ALL.get(key, set())
            if not allowed:
                continue
            group, right, kind = key
            at: Any = ET.SubElement(profile, group, {right: "ALLOW"})
            for each in sorted(allowed):
                ET.SubElement(at, kind).text = f"/{each}"


def main(argv: list[str] | None = None) -> int:
    """Write the policy, or check it; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; 1 if it is stale")
    options = parser.parse_args(argv)
    use_loopback()
    os.environ.pop("ROS_NAMESPACE", None)
    new = policy(own_domain())
    if options.check:
        stale = not POLICY.exists() or POLICY.read_text(encoding="utf-8") != new
        if stale:
            print(f"{POLICY} is stale: run tools/security.py", file=sys.stderr)
        return int(stale)
    POLICY.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
