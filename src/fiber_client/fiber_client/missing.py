# SPDX-License-Identifier: Apache-2.0
"""What a client still misses before it can use the graph."""

from collections.abc import Iterator, Mapping, Sequence

from rclpy.client import Client
from rclpy.publisher import Publisher

from fiber_client.monitor import STAGES, PlaneMonitor
from fiber_msgs_py import Service, Status
from fiber_node import BRIDGE, claims

__all__ = ["missing_parts"]

_UNNAMED = "_NODE_NAME_UNKNOWN_"  # as rmw names the node of an endpoint that it does not know
_TARGET_RECEIVERS = ("planner", "bridge")


def missing_parts(
    monitor: PlaneMonitor,
    services: Mapping[Service, Client],
    targets: Publisher,
    also: Sequence[str],
) -> list[str]:
    """Return the names of what is missing: services, states, nodes, and their connections.

    Args:
        monitor: the state that the client has received.
        services: its clients of the bridge's services.
        targets: its publisher of targets.
        also: names of other nodes that must be there and receive targets, such as "recorder".
    """
    return list(_iterate_missing(monitor, services, targets, also))


def _knows_plane(monitor: PlaneMonitor, status: Status) -> bool:
    known = status.values.get("robots"), status.values.get("session")
    return known == (str(monitor.plane.n), monitor.session)


def _iterate_missing(
    monitor: PlaneMonitor,
    services: Mapping[Service, Client],
    targets: Publisher,
    also: Sequence[str],
) -> Iterator[str]:
    if monitor.node.get_parameter("use_sim_time").value and not monitor.now_ns():
        yield f"time on {monitor.node.resolve_topic_name('/clock')} (use_sim_time is set)"
        return
    for service, client in services.items():
        if not client.service_is_ready():
            yield service.name
    if monitor.states_of_layout() is None:
        yield "joint_states" if monitor.has_layout else "layout"
        return
    if monitor.session not in claims(monitor.node, BRIDGE):
        yield "a bridge"
        return
    statuses = monitor.statuses
    yield from _stages_missing(monitor)
    for name in also:
        if name not in statuses:
            yield f"diagnostics of {name}"
    # other nodes may subscribe too, so a count alone would not tell that these do
    found = monitor.node.get_subscriptions_info_by_topic(targets.topic_name)
    if targets.get_subscription_count() < len(found):
        yield "a connection to every subscription of targets"
        return
    names = {f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in found}
    unseen = []
    for name in (*_TARGET_RECEIVERS, *also):
        status = statuses.get(name)
        if status is None or status.values.get("node") not in names:
            unseen.append(name)
    # a node that was paused for longer than its lease comes back without its name
    if len(unseen) > [info.node_name for info in found].count(_UNNAMED):
        yield from (f"{name} to subscribe to targets" for name in unseen)


def _stages_missing(monitor: PlaneMonitor) -> Iterator[str]:
    for stage in STAGES:
        status = monitor.statuses.get(stage)
        if not claims(monitor.node, stage):
            yield f"a {stage}"
        elif status is None:
            yield f"diagnostics of {stage}"
        elif status.values.get("state", "active") != "active":
            yield f"{stage} to be activated, it is {status.values['state']}"
        elif stage != BRIDGE and not _knows_plane(monitor, status):
            yield f"{stage} to know the plane"
