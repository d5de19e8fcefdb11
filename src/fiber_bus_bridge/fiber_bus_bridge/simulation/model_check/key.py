# SPDX-License-Identifier: Apache-2.0
"""The state of a system as bytes that do not depend on the time of day."""

import numpy as np

from fiber_bus_bridge.protocol import BUS, ROBOT, Context, State
from fiber_bus_bridge.simulation.memory import Memory
from fiber_bus_bridge.simulation.model_check.choices import ChosenBuses
from fiber_bus_bridge.simulation.model_check.truth import Truth
from fiber_bus_bridge.wire import RobotState
from fiber_core.array_types import Floats

__all__ = ["RESOLUTION_S", "state_parts"]

RESOLUTION_S = 0.25e-3  # states whose times differ by less are one state
# columns without influence on what follows, and times, which count from the present
_ROBOT_LEFT_OUT = {"read_s", "velocity", "in_traffic_s"}
_ROBOT = [name for name in ROBOT.names or () if name not in _ROBOT_LEFT_OUT]
_BUS = ["sequence", "stale", "slow"]
_BUS_TIMES = ["heartbeat_s", "called_s", "called_before_s"]
_MEMORY = ["powered", "position", "boot", "state", "fault", "alerts", "tick_us", "sequence"]
_MEMORY += ["executed", "order_length"]
_WATCHED = (State.COUNTDOWN, State.CANCELLING, State.MOVING, State.STOPPING)
_MOVING = int(RobotState.MOVING)
assert set(_BUS) | set(_BUS_TIMES) | {"shortest_s"} == set(BUS.names or ())


def state_parts(c: Context, buses: ChosenBuses, truth: Truth) -> list[bytes]:
    """Return the state of a controller, its buses, the robots, and the truth, as bytes."""
    now_s = c.now_s
    parts = [c.state.name.encode()]
    parts += [c.robots[name].tobytes() for name in _ROBOT]
    parts += [c.buses[name].tobytes() for name in _BUS]
    parts += [c.transactions.given_up.tobytes(), _ago(c.transactions.free_s, now_s)]
    parts += [_ago(buses.free_s, now_s), repr(buses.stuck).encode()]
    parts += _of_phase(c, now_s) + _of_robots(buses.memory, c.state, now_s)
    numbers = (truth.committed == truth.attempt, truth.stopped, len(truth.wrong))
    parts += [repr(numbers).encode(), (truth.accepted == truth.attempt).tobytes()]
    parts += [truth.rest.tobytes(), repr(sorted(truth.certified.items())).encode()]
    return parts


def _ago(times: Floats, now_s: float) -> bytes:
    return np.rint((times - now_s) / RESOLUTION_S + 0.0).tobytes()


def _of_phase(c: Context, now_s: float) -> list[bytes]:
    parts, phase, watch = [repr(len(c.loaded_plans)).encode()], c.phase, c.watch
    if c.plan is not None:
        parts += [x.tobytes() for x in (c.plan.motion.ticks, c.plan.motion.velocity)]
    if c.loaded_plan is not None:
        plan = c.loaded_plan
        parts += [plan.started.tobytes(), plan.reason.tobytes(), plan.motion.velocity.tobytes()]
    if phase is not None:
        parts += [x.tobytes() for x in (phase.motion.ticks, phase.motion.velocity)]
        masks = (phase.late, phase.responding, phase.resumed, phase.oversized)
        parts += [b"" if mask is None else mask.tobytes() for mask in masks]
        if watch is not None or c.state is State.RESUMING:
            parts.append(_ago(np.array([phase.start_s, phase.stopped_at_s]), now_s))
        parts += [_ago(np.array([phase.verify_s]), 0.0)]
        parts += [repr(phase.rounds).encode()]
    if watch is not None:
        stop_s = np.inf if watch.stop_all_at_s is None else watch.stop_all_at_s
        parts += [_ago(np.array([watch.now_s, watch.ends_s, stop_s]), now_s)]
        parts += [watch.low_lines.tobytes()]
        parts += [_ago(c.buses[name], now_s) for name in _BUS_TIMES]
        parts += [_ago(c.buses["shortest_s"], 0.0)]
        parts += [part for s in watch.schedulers.values() for part in s.state()]
    return parts


def _of_robots(memory: Memory, state: State, now_s: float) -> list[bytes]:
    parts = [memory[name].tobytes() for name in _MEMORY]
    parts += [r["order"][: r["order_length"]].tobytes() for r in memory]
    # of times that have passed it matters only that they have
    boots_s = np.maximum(memory["boots_until_s"], now_s)
    alert = np.isfinite(memory["alert_s"])
    jam = np.isfinite(memory["jam_s"])
    moving = memory["state"] == _MOVING
    running = np.where(moving, memory["started_s"], now_s)
    heartbeat_s = np.where(moving, memory["heartbeat_s"], now_s)
    parts += [_ago(boots_s, now_s), alert.tobytes(), jam.tobytes()]
    parts += [_ago(running, now_s), _ago(heartbeat_s, now_s)]
    if state in _WATCHED:
        parts.append(_ago(memory["halted_s"], now_s))  # for the time between stops
    return parts
