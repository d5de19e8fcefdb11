# SPDX-License-Identifier: Apache-2.0
"""Orders to the bridge, as services and parameters, for a caller that waits in a thread."""

import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future

from fiber_client.errors import PlaneRefusal
from fiber_console.errors import ConsoleError
from fiber_msgs_py import topics
from fiber_node import BRIDGE, RepeatedRequest, claims

__all__ = ["ORDERS", "BridgeOrders"]

_SERVICES = {
    service.name.rpartition("/")[2]: service
    for service in (topics.START, topics.STOP, topics.HOME, topics.CLEAR, topics.CONFIGURE)
}
ORDERS = (*_SERVICES, "disable", "enable")
_BRIDGE = "bridge"


class BridgeOrders:
    """Passes orders on to the bridge. An executor of another thread must run the node.

    Args:
        node: the node that asks.
        bridge_node: returns the full name of the bridge node, None as long as it is unknown.
        timeout_s: longest wait for an answer [s].
    """

    def __init__(self, node: Node, bridge_node: Callable[[], str | None], timeout_s: float):
        self._node, self._bridge_node, self._timeout_s = node, bridge_node, timeout_s
        self._clients = {name: service.client(node) for name, service in _SERVICES.items()}
        self._parameters: AsyncParameterClient | None = None
        self._lock = threading.Lock()  # disabling reads the list and writes it

    def __call__(self, order: str, plan: str | None, ids: Sequence[int], why: str) -> str:
        """Carry out one order; return the answer of the bridge.

        Args:
            order: one of ORDERS.
            plan: the stamp of the plan that is meant; needed for start.
            ids: ids of the robots that are disabled or enabled.
            why: why they are disabled.

        Raises:
            PlaneRefusal: the bridge refused; gives its reason.
            ConsoleError: the order is unknown or incomplete, or the bridge does not answer.
        """
        if order not in ORDERS:
            raise ConsoleError(f"{order!r} is no order: choose from {', '.join(ORDERS)}")
        if order in ("disable", "enable"):
            with self._lock:
                return self._change_disabled(order, set(ids), why)
        if order == "start":
            if not plan:
                raise ConsoleError("start needs the plan that is meant")
            named = Parameter("start_plan", Parameter.Type.STRING, plan)
            self._answer_of(self._bridge_parameters().set_parameters([named]), "start_plan")
        client = self._clients[order]
        if not client.service_is_ready():
            raise ConsoleError(f"{order}: there is no bridge in the graph")
        living = partial(claims, self._node, BRIDGE)
        request = RepeatedRequest(self._node, client, _SERVICES[order].type.Request(), living)
        if not request.wait(self._timeout_s):
            raise self._silent(order)
        answer = request.result()
        if answer is None:
            raise ConsoleError(f"{order}: the bridge gave no answer")
        if not answer.success:
            raise PlaneRefusal(_BRIDGE, answer.message)
        return answer.message

    def _change_disabled(self, order: str, ids: set[int], why: str) -> str:
        if not ids:
            raise ConsoleError(f"{order}: name robots by their ids")
        parameters = self._bridge_parameters()
        found = self._answer_of(parameters.get_parameters(["disabled"]), "disabled")
        disabled = set(found.values[0].integer_array_value) if found.values else set()
        if order == "enable" and ids - disabled:
            raise ConsoleError(f"robot {min(ids - disabled)} is not on the list of disabled robots")
        new = disabled | ids if order == "disable" else disabled - ids
        answer = self._answer_of(
            parameters.set_parameters_atomically(
                [
                    Parameter("disabled_why", Parameter.Type.STRING, why),
                    Parameter("disabled", Parameter.Type.INTEGER_ARRAY, sorted(new)),
                ]
            ),
            "disabled",
        )
        if not answer.result.successful:
            raise PlaneRefusal(_BRIDGE, answer.result.reason)
        return f"disabled: {', '.join(map(str, sorted(new)))}" if new else "no robot is disabled"

    def _bridge_parameters(self) -> AsyncParameterClient:
        name = self._bridge_node()
        if name is None:
            raise ConsoleError("no bridge has told its name yet")
        if self._parameters is None or self._parameters.remote_node_name != name:
            self._parameters = AsyncParameterClient(self._node, name)
        if not self._parameters.wait_for_services(self._timeout_s):
            raise ConsoleError(f"the parameters of {name} cannot be reached")
        return self._parameters

    def _answer_of(self, future: Future, what: str) -> Any:
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        if not done.wait(self._timeout_s):
            raise self._silent(what)
        return future.result()

    def _silent(self, what: str) -> ConsoleError:
        return ConsoleError(f"{what}: the bridge did not answer within {self._timeout_s:g} s")
