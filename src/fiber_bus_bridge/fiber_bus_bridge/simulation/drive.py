# SPDX-License-Identifier: Apache-2.0
"""Execution of a stored order by a positioner: whole numbers on its own clock."""

import numpy as np
from numba import njit

from fiber_bus_bridge.simulation.memory import NOTHING, Robot
from fiber_bus_bridge.simulation.working_values import place_crc, working_crc
from fiber_bus_bridge.wire.codes import MAX_SEGMENTS, Alert, Fault, RobotState
from fiber_bus_bridge.wire.config_blocks import GEAR_UNIT, MOTOR_SPEED_UNIT
from fiber_bus_bridge.wire.fields import Bytes, Whole
from fiber_bus_bridge.wire.frames import frame_crc
from fiber_bus_bridge.wire.orders import read_order
from fiber_bus_bridge.wire.roll_call import NO_SLOT
from fiber_bus_bridge.wire.speed_block import least_ticks, number_of

__all__ = [
    "advance_robot",
    "encoder",
    "halt",
    "order_refusal",
    "reboot",
    "start_order",
    "verified_crc",
]

_UNCONFIGURED = int(RobotState.UNCONFIGURED)
_LOADED, _MOVING = int(RobotState.LOADED), int(RobotState.MOVING)
_DONE, _FAULT = int(RobotState.DONE), int(RobotState.FAULT)
_NONE, _OVER_SPEED = int(Fault.NONE), int(Fault.OVER_SPEED)
_OUTSIDE_LIMITS = int(Fault.OUTSIDE_LIMITS)
_UNLISTED, _SHORT = int(Fault.UNLISTED_SPEED), int(Fault.SHORT_MOVE)
_WATCHDOG, _MEMORY = int(Fault.WATCHDOG), int(Fault.MEMORY)
_STALL, _SILENCE = int(Fault.STALL), int(Fault.SILENCE)
_LAPSED, _REBOOTED = int(Alert.LAPSED), int(Alert.REBOOTED)
_STALLED, _SILENT = int(Alert.STALLED), int(Alert.SILENT)


@njit(cache=True)
def _ticks_run(r, t):
    """Ticks of the robot's own clock since the motion began, with the fraction."""
    return (t - r.started_s) * (1e6 + r.clock_ppm) / r.tick_us


@njit(cache=True)
def _length(r, joint):
    """Duration of the order of one joint [ticks]."""
    total = 0
    for k in range(r.counts[joint]):
        total += r.ticks[joint, k]
    return total


@njit(cache=True)
def encoder(r: Robot, joint: int, t: float) -> Whole:
    """Return the position of a joint at time t [quanta]: exact at ticks, else rounded."""
    position = r.position[joint]
    run = _ticks_run(r, t) if r.state == _MOVING else 0.0
    if run <= 0.0:
        return position
    left = np.int64(np.floor(run))
    fraction = run - left
    for k in range(r.counts[joint]):
        whole = min(left, r.ticks[joint, k])
        position += whole * r.velocity[joint, k]
        if whole < r.ticks[joint, k]:
            return position + np.int64(np.rint(fraction * r.velocity[joint, k]))
        left -= whole
    return position


@njit(cache=True)
def halt(r: Robot, t: float) -> None:
    """Stop a robot at time t [s] and delete its order; the caller sets its state."""
    theta, phi = encoder(r, 0, t), encoder(r, 1, t)
    r.position[0], r.position[1] = theta, phi
    r.order_length = 0
    if r.state == _MOVING:
        r.halted_s = t


@njit(cache=True)
def _stall_s(r):
    """Return the time at which a jammed joint is first ordered to turn [s], inf if never."""
    first = np.inf
    for joint in range(2):
        begin = r.started_s
        for k in range(r.counts[joint]):
            end = begin + r.ticks[joint, k] * r.tick_us / (1e6 + r.clock_ppm)
            if r.velocity[joint, k] != 0 and end > r.jam_s[joint]:
                first = min(first, max(begin, r.jam_s[joint]))
                break
            begin = end
    return first


@njit(cache=True)
def advance_robot(r: Robot, t: float) -> None:
    """Advance a robot to time t [s]: motions end or are broken off, unstarted orders lapse."""
    if r.state == _MOVING:
        done = r.done_s
        silent = r.heartbeat_s + r.silence_s if r.silence_s > 0.0 else np.inf
        jammed = r.jam_s[0] < np.inf or r.jam_s[1] < np.inf
        stall = _stall_s(r) if jammed else np.inf
        # the earliest of the three events ends the motion
        if done <= min(t, silent, stall):
            # exactly the end of the order: no time is rounded
            for joint in range(2):
                for k in range(r.counts[joint]):
                    r.position[joint] += r.ticks[joint, k] * r.velocity[joint, k]
            r.order_length = 0
            r.halted_s = done
            r.state = _DONE
        elif stall <= min(t, silent):
            # the drive checks that its joints follow, and stops both at the same time
            halt(r, stall)
            r.state, r.fault = _FAULT, _STALL
            r.alerts |= _STALLED
            r.alert_s = stall
        elif silent <= t:
            halt(r, silent)
            r.state, r.fault = _FAULT, _SILENCE
            r.alerts |= _SILENT
            r.alert_s = silent
    elif r.state == _LOADED and 0.0 < r.watchdog_s < t - r.loaded_s:
        r.order_length = 0
        r.state = _FAULT
        r.fault = _WATCHDOG
        r.alerts |= _LAPSED


@njit(cache=True)
def _read(r, data, first, last, counts, ticks, velocity):
    """Read an order by the values that the robot works by; return its Fault, or NONE."""
    return read_order(
        r.address, r.ten_bit, data, first, last, r.velocity_bits, r.duration_bits,
        r.listed, 0 if r.listed_bytes else -1, counts, ticks, velocity,
    )  # fmt: skip


@njit(cache=True)
def order_refusal(r: Robot, data: Bytes, first: Whole, last: Whole) -> int:
    """Return the Fault for which a robot refuses an order: bytes, limits, speeds; or NONE."""
    counts = np.empty(2, dtype=np.int64)
    ticks, velocity = np.empty((2, 2, MAX_SEGMENTS), dtype=np.int64)
    fault = _read(r, data, first, last, counts, ticks, velocity)
    if fault != _NONE:
        return fault
    for joint in range(2):
        position = r.position[joint]
        # a robot outside its limits may return, and may not move further out
        low = min(position, r.limits[joint, 0])
        high = max(position, r.limits[joint, 1])
        for k in range(counts[joint]):
            if abs(velocity[joint, k]) > r.speed[joint]:
                return _OVER_SPEED
            position += ticks[joint, k] * velocity[joint, k]
            if position < low or position > high:
                return _OUTSIDE_LIMITS
    if r.listed_bytes:
        for joint in range(2):
            fault = _list_refusal(r.listed, joint, counts[joint], ticks[joint], velocity[joint])
            if fault != _NONE:
                return fault
    return _motors_refusal(r, counts, ticks, velocity) if r.coupling.any() else _NONE


@njit(cache=True)
def _list_refusal(listed, joint, count, ticks, velocity):
    """Return the Fault of moves that a motor with listed speeds cannot make, or NONE."""
    k = 0
    while k < count:
        way, lasts = velocity[k], 0
        while k < count and velocity[k] == way:  # segments of one velocity are one move
            lasts += ticks[k]
            k += 1
        if way == 0:
            continue
        speed = number_of(listed, 0, way, joint)
        if speed < 0:
            return _UNLISTED
        if lasts < least_ticks(listed, 0, speed, joint, 1 if way > 0 else 0):
            return _SHORT
    return _NONE


@njit(cache=True)
def _motors_refusal(r, counts, all_ticks, all_velocity):
    """Return the Fault of the coupled motors in an order whose joints are in order, or NONE.

    Both joints are followed at once, from one segment of either joint to the next.
    """
    at, position = np.zeros(2, dtype=np.int64), r.position.copy()
    ticks, velocity = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.int64)
    begin = _motors(r, position)
    while True:
        step = 0
        for joint in range(2):
            if ticks[joint] == 0:
                velocity[joint] = 0
                if at[joint] < counts[joint]:
                    ticks[joint] = all_ticks[joint, at[joint]]
                    velocity[joint] = all_velocity[joint, at[joint]]
                    at[joint] += 1
            if ticks[joint] > 0:
                step = min(step, ticks[joint]) if step else ticks[joint]
        if step == 0:
            return _NONE
        position += step * velocity
        ticks -= np.minimum(ticks, step)
        speed, place = _motors(r, velocity), _motors(r, position)
        for motor in range(2):
            if abs(speed[motor]) > r.motor_speed[motor] * MOTOR_SPEED_UNIT:
                return _OVER_SPEED
            low = min(begin[motor], r.motor_limits[motor, 0])
            high = max(begin[motor], r.motor_limits[motor, 1])
            if place[motor] < low or place[motor] > high:
                return _OUTSIDE_LIMITS


@njit(cache=True)
def _motors(r, joints):
    """Return positions or velocities of both motors by those of the joints."""
    motors = np.empty(2)
    for k in range(2):
        motors[k] = r.coupling[k, 0] * joints[0] + r.coupling[k, 1] * joints[1]
    return motors * GEAR_UNIT


@njit(cache=True)
def verified_crc(r: Robot) -> Whole:
    """Return the checksums over order, working values and counters as they are in memory now.

    They are added bit by bit, so that a VERIFY tells of all three; 0 without an order.
    """
    if r.order_length == 0:
        return 0
    return _order_crc(r) ^ working_crc(r) ^ place_crc(r)


@njit(cache=True)
def _order_crc(r):
    """Return the checksum over the stored order as it is in memory now."""
    return frame_crc(r.address, r.ten_bit, r.order, 0, r.order_length - 2)


@njit(cache=True)
def start_order(r: Robot, t: float, countdown_s: float) -> None:
    """Decode the stored order and run it after a countdown, unless a checksum has changed.

    The values by which the order is decoded are as old as the CONFIG, and a MOVES order means
    nothing without them: they are checked too.
    """
    order, last = r.order, r.order_length - 2
    crc = (np.int64(order[last]) << 8) | np.int64(order[last + 1])
    damaged = _order_crc(r) != crc or working_crc(r) != r.config_crc
    if damaged or _read(r, order, 0, last + 2, r.counts, r.ticks, r.velocity) != _NONE:
        r.order_length = 0
        r.state = _FAULT
        r.fault = _MEMORY
        return
    r.started_s = t + countdown_s * 1e6 / (1e6 + r.clock_ppm) + r.start_skew_s
    # the end is known now: it would be looked for in all segments at each heartbeat
    ticks = max(_length(r, 0), _length(r, 1))
    r.done_s = r.started_s + ticks * r.tick_us / (1e6 + r.clock_ppm)
    r.heartbeat_s = t
    r.executed = r.sequence
    r.state = _MOVING


@njit(cache=True)
def reboot(r: Robot, t: float) -> None:
    """Stop a robot, delete order and configuration, and count one more boot."""
    halt(r, t)
    if r.volatile:
        r.position[0] = r.position[1] = 0
    r.state = _UNCONFIGURED
    r.fault = _NONE
    r.alerts = _REBOOTED
    r.alert_s = t
    r.identity_requested = False
    r.tick_us = 0
    r.watchdog_s = r.silence_s = 0.0
    r.slot = NO_SLOT
    r.sequence = 0
    r.executed = NOTHING
    r.boot = (r.boot + 1) % 256
