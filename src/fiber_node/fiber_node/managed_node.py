# SPDX-License-Identifier: Apache-2.0
"""The base of managed nodes: unconfigured, inactive, active, as transitions from outside say."""

import traceback
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.callback_groups import CallbackGroup
from rclpy.lifecycle.node import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from fiber_core.errors import FiberError
from fiber_msgs_py import Status
from fiber_node.plane_node import PlaneNode
from fiber_node.reporter import Reporter

__all__ = ["ManagedNode"]


@dataclass(frozen=True)
class _Autostart:
    """How the node begins.

    Args:
        autostart: whether the node configures and activates itself when it starts; without it the
            node waits for these transitions, as of `ros2 lifecycle set`.
    """

    autostart: bool = True


class ManagedNode(LifecycleNodeMixin, PlaneNode):
    """A node of the graph that can be configured, activated, deactivated and cleaned up.

    A derived class declares its parameters, calls `begin`, and has the four hooks below, each of
    which refuses its transition by raising a FiberError. What `configure` makes of publishers,
    subscriptions, services, timers and workers is given up with `cleanup`. The services of the
    transitions, parameters and diagnostics are there in every state; a transition that is not
    possible is answered with a failure.

    Args:
        name: name of the node.
        role: name of the node in progress and diagnostics.
        group: callback group of the transitions; that of all callbacks without one.
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, name: str, role: str, group: CallbackGroup | None = None, **options: Any):
        PlaneNode.__init__(self, name, **options)
        LifecycleNodeMixin.__init__(self, callback_group=group)
        self._autostart = self.parameters.declare(_Autostart, read_only=True).value.autostart
        self.active = False
        self.reporter = Reporter(self, role, self.statuses)
        self._refusal: FiberError | None = None
        self._kept: set[int] = set()  # what is there in every state
        # rclpy's own raises where a transition is not possible, which would end the node
        change_state: Any = self._service_change_state
        change_state.callback = self._on_change_state

    def begin(self) -> None:
        """Configure and activate the node, if it starts by itself.

        Raises:
            FiberError: it cannot be configured or activated; the node is given up.
        """
        self._show("unconfigured")
        if not self._autostart:
            self.get_logger().info("unconfigured: waits for the transition configure")
            return
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                self.destroy_node()
                raise self._refusal or FiberError(f"{self.get_name()} does not start")

    def destroy_node(self) -> None:
        """Give up the node and its state machine."""
        super().destroy_node()
        # rclpy keeps the state machine, which keeps the node and its participant of the middleware
        for name in [name for name in vars(self) if name.startswith("_service_")]:
            delattr(self, name)
        self.__dict__.pop("_state_machine", None)

    def configure(self) -> None:
        """Make all that the node works with; afterwards it hears and does not act."""

    def activate(self) -> None:
        """Begin to act."""

    def deactivate(self) -> None:
        """End what is under way, and act no more."""

    def cleanup(self) -> None:
        """Give up what is no part of ROS; the rest of what `configure` made goes by itself."""

    def statuses(self) -> Iterable[Status]:
        """Return the further statuses in the diagnostics of the node."""
        return ()

    # --- transitions ---------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Configure, as rclpy calls it."""
        self._kept = {id(each) for each in self._entities()}
        result = self._run(self.configure, "inactive")
        if result != TransitionCallbackReturn.SUCCESS:
            self._release()
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Activate, as rclpy calls it."""
        result = self._run(self.activate, "active")
        self.active = result == TransitionCallbackReturn.SUCCESS
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Deactivate, as rclpy calls it."""
        self.active = False  # what is about to begin does not
        result = self._run(self.deactivate, "inactive")
        self.active = result == TransitionCallbackReturn.FAILURE
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Clean up, as rclpy calls it."""
        result = self._run(self.cleanup, "unconfigured")
        if result == TransitionCallbackReturn.SUCCESS:
            self._release()
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Shut down from any state, as rclpy calls it; the process goes on, and does nothing."""
        self._end(state.label)
        self._show("finalized")
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Give everything up after an unexpected error in a transition; then it can begin anew."""
        self._end(state.label)
        self._show("unconfigured")
        return TransitionCallbackReturn.SUCCESS

    def _end(self, state: str) -> None:
        self.active = False
        if state == "active":
            self._run(self.deactivate, "inactive")
        if state != "unconfigured":
            self._run(self.cleanup, "unconfigured")
        self._release()

    def _run(self, hook: Callable[[], None], reached: str) -> TransitionCallbackReturn:
        try:
            hook()
        except FiberError as error:
            self._refusal = error
            self.reporter.refuse(f"transition {hook.__name__} refused: {error}")
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            if not self.context.ok():
                raise KeyboardInterrupt from None  # after a signal whatever is sent fails
            text = f"transition {hook.__name__}: unexpected {type(error).__name__}: {error}"
            self._refusal = FiberError(text)
            self.get_logger().error(traceback.format_exc())
            self.reporter.refuse(text)
            return TransitionCallbackReturn.ERROR
        self._show(reached)
        return TransitionCallbackReturn.SUCCESS

    def _show(self, state: str) -> None:
        self.get_logger().debug(f"state: {state}")
        before = {} if state == "unconfigured" else self.reporter.counters
        self.reporter.counters = before | {"state": state}
        self.reporter.waiting(state)
        self.reporter.publish()

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        wanted = request.transition
        for number, label, *_ in self._state_machine.available_transitions:
            if wanted.label == label if wanted.label else wanted.id == number:
                trigger = getattr(self, f"trigger_{label}")
                response.success = trigger() == TransitionCallbackReturn.SUCCESS
                state = self._state_machine.current_state[1]
                self.get_logger().info(f"transition {label}: the node is {state}")
                return response
        state = self._state_machine.current_state[1]
        name = wanted.label or str(wanted.id)
        self.reporter.refuse(f"transition {name} refused: the node is {state}")
        response.success = False
        return response

    # --- what configure makes ------------------------------------------------

    def _entities(self) -> list[Any]:
        return [
            *self.publishers, *self.subscriptions, *self.services, *self.clients, *self.timers
        ]  # fmt: skip

    def _release(self) -> None:
        self.end_workers()

        def made(entities: Iterable[Any]) -> list[Any]:
            return [each for each in entities if id(each) not in self._kept]

        for publisher in made(self.publishers):
            self.destroy_publisher(publisher)
        for subscription in made(self.subscriptions):
            self.destroy_subscription(subscription)
        for service in made(self.services):
            self.destroy_service(service)
        for client in made(self.clients):
            self.destroy_client(client)
        for timer in made(self.timers):
            self.destroy_timer(timer)
