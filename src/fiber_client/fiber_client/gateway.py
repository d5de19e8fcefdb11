# SPDX-License-Identifier: Apache-2.0
"""The node `gateway`: the action `reconfigure` and the service `start_plan`, over the client.

It needs the package `fiber_interfaces`, which is built where a compiler is.
"""

import math
import signal
import sys
import threading
import traceback
from collections.abc import Sequence
from typing import Any

import numpy as np
import rclpy
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse, ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context

from fiber_client.client import PlaneClient
from fiber_client.client_worker import ClientWorker, Interrupted
from fiber_client.errors import PlaneError
from fiber_core.errors import FiberError
from fiber_core.outcomes import Outcome, PlanOutcome
from fiber_interfaces.action import Reconfigure  # pyright: ignore[reportMissingModuleSource]
from fiber_interfaces.srv import Start  # pyright: ignore[reportMissingModuleSource]
from fiber_msgs_py import PlanStamp, Progress, topics
from fiber_msgs_py.stamps import ns_from_time
from fiber_node import PlaneNode, ThreadExecutor, warn_of_sections
from fiber_node.deafness import watch_hearing
from fiber_node.ros_environment import keep_memory_private, keep_private, use_loopback

__all__ = ["RECONFIGURE", "START_PLAN", "GatewayNode", "main"]

RECONFIGURE = f"{topics.NAMESPACE}/reconfigure"
START_PLAN = topics.Service(f"{topics.NAMESPACE}/start_plan", Start)

_START_S = 60.0  # time-out of the service start
_STOP_S = 20.0  # time-out of a stop, and of the outcome after it
_THREADS = 3  # a goal, a call of start_plan, and all that is answered at once
_LONGEST_S = 86_400.0


class GatewayNode(PlaneNode):
    """Serves the action `reconfigure` and the service `start_plan`, one request at a time.

    A goal is rejected, and a call refused, while another is under way. Canceling a goal, and
    ending the node during one, call the service `stop`.

    Args:
        options: keyword arguments of rclpy.node.Node.
    """

    def __init__(self, **options: Any):
        super().__init__("gateway", **options)
        self.parameters.finish()
        self._busy = threading.Lock()
        self._goal: ServerGoalHandle | None = None  # the goal whose plan is under way
        self._plan: PlanStamp | None = None
        self._cancel = threading.Event()  # of the goal that was accepted last
        self._worker = ClientWorker(self.context.get_domain_id(), self._publish_feedback)
        group = ReentrantCallbackGroup()
        self._server = ActionServer(
            self,
            Reconfigure,
            RECONFIGURE,
            self._execute,
            callback_group=group,
            goal_callback=self._on_goal,
            cancel_callback=self._on_cancel,
        )
        START_PLAN.server(self, self._on_start, callback_group=group)
        self.get_logger().info("waits for goals of reconfigure and calls of start_plan")

    def close(self) -> None:
        """End the request under way, with a stop of the robots if it is a goal."""
        self._worker.close()

    # --- the action ----------------------------------------------------------

    def _on_goal(self, goal: Reconfigure.Goal) -> GoalResponse:
        if not self._busy.acquire(blocking=False):
            self.get_logger().warning("goal rejected: another request is under way")
            return GoalResponse.REJECT
        self._cancel = threading.Event()
        self.get_logger().info(f"goal accepted: targets for {len(goal.ids)} robots")
        return GoalResponse.ACCEPT

    def _on_cancel(self, _: ServerGoalHandle) -> CancelResponse:
        self.get_logger().info("goal canceled: the robots are stopped")
        self._cancel.set()
        return CancelResponse.ACCEPT

    def _execute(self, goal: ServerGoalHandle) -> Reconfigure.Result:
        result = Reconfigure.Result()
        self._goal = goal
        try:
            self._worker.call(
                lambda client: self._reconfigure(client, goal.request, result), self._cancel
            )
            goal.succeed()
        except Interrupted as error:
            result.message = str(error)
            if goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.abort()
        except FiberError as error:
            result.message = str(error)
            goal.abort()
        except Exception as error:  # a defect; the robots were stopped if they had been started
            result.message = f"unexpected {type(error).__name__}: {error}"
            self.get_logger().error(traceback.format_exc())
            goal.abort()
        finally:
            self._goal = self._plan = None
            self._busy.release()
        self.get_logger().info(f"goal ended: {result.message}")
        return result

    def _reconfigure(
        self, client: PlaneClient, goal: Reconfigure.Goal, result: Reconfigure.Result
    ) -> None:
        """Carry out a goal and fill its result."""
        ids, xy_mm = _targets_of(goal)
        client.wait_for_graph(goal.timeout)
        started = False
        self._plan = stamp = client.send_targets(ids, xy_mm)
        result.plan = stamp.to_time()
        try:
            client.wait_until_ready(stamp, goal.timeout)
            if goal.plan_only:
                result.message = "the orders are ready to be started"
                return
            started = True
            with client.stops_on_error(_STOP_S):
                client.start(goal.timeout)
                outcome = client.wait_for_outcome(stamp, goal.timeout)
        except Interrupted:
            if started:  # and stopped by now
                _fill(result, client.wait_for_outcome(stamp, _STOP_S).of(ids))
            else:
                client.call_service(topics.STOP, _STOP_S)
            raise Interrupted("the robots were stopped") from None
        _fill(result, outcome.of(ids))
        reached = outcome.of(ids).count(Outcome.REACHED)
        result.message = f"{reached} of {len(ids)} robots reached their targets"

    def _publish_feedback(self, progress: Progress) -> None:
        goal, plan = self._goal, self._plan
        if goal is None or progress.attempt.plan != plan or not goal.is_active:
            return
        goal.publish_feedback(
            Reconfigure.Feedback(
                stage=progress.stage, fraction=float(progress.fraction), text=progress.text
            )
        )

    # --- the service ---------------------------------------------------------

    def _on_start(self, request: Start.Request, response: Start.Response) -> Start.Response:
        if not self._busy.acquire(blocking=False):
            response.message = "another request is under way"
            return response
        try:
            plan = PlanStamp(ns_from_time(request.plan))
            response.message = self._worker.call(lambda client: client.start(_START_S, plan))
            response.success = True
        except FiberError as error:
            response.message = str(error)
        finally:
            self._busy.release()
        self.get_logger().info(f"start_plan: {response.message}")
        return response


def _targets_of(goal: Reconfigure.Goal) -> tuple[np.ndarray, np.ndarray]:
    """Return ids, shape (k,), and targets [mm], shape (k, 2), of a goal."""
    if not len(goal.ids) == len(goal.x) == len(goal.y):
        counts = f"{len(goal.ids)} ids, {len(goal.x)} x and {len(goal.y)} y"
        raise PlaneError(f"a goal needs as many targets as ids, got {counts}")
    if not (math.isfinite(goal.timeout) and 0 < goal.timeout <= _LONGEST_S):
        raise PlaneError(f"timeout must be 0 to {_LONGEST_S:g} s, got {goal.timeout}")
    return np.array(goal.ids), 1e3 * np.stack([np.array(goal.x), np.array(goal.y)], axis=1)


def _fill(result: Reconfigure.Result, outcome: PlanOutcome) -> None:
    result.ids = outcome.ids.tolist()
    result.outcome = outcome.outcome.tolist()
    result.reason = outcome.reason.tolist()
    result.error = (outcome.error_mm / 1e3).tolist()


def main(args: Sequence[str] | None = None) -> int:
    """Run the gateway until it is interrupted; robots of a goal under way are stopped then."""
    ended = threading.Event()
    for each in (signal.SIGINT, signal.SIGTERM):  # a second signal does not end the stop
        signal.signal(each, lambda *_: ended.set())
    use_loopback()
    keep_private()
    # a context of its own: rclpy's handlers of signals would cut the client off before it can stop
    context = Context()
    given = list(sys.argv if args is None else args)
    rclpy.init(args=given, context=context)
    executor = ThreadExecutor(_THREADS, context)
    node = GatewayNode(context=context)
    keep_memory_private()
    watch_hearing()
    warn_of_sections(node, given)
    executor.add_node(node)
    loop = threading.Thread(target=executor.spin, name="gateway", daemon=True)
    loop.start()
    try:
        ended.wait()
    finally:
        node.close()
        executor.stop()
        loop.join()
        executor.shutdown()
        node.destroy_node()
        context.try_shutdown()
    return 0
