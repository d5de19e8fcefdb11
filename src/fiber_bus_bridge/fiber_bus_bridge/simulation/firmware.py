# SPDX-License-Identifier: Apache-2.0
"""Firmware of a simulated positioner: check the received bytes, then act or refuse."""

import numpy as np
from numba import njit

from fiber_bus_bridge.simulation.drive import (
    advance_robot,
    encoder,
    halt,
    order_refusal,
    reboot,
    start_order,
    verified_crc,
)
from fiber_bus_bridge.simulation.memory import NOTHING, Robot
from fiber_bus_bridge.wire.codes import COUNTDOWN_S, VERSION, Alert, Fault, Opcode, RobotState
from fiber_bus_bridge.wire.commands import (
    ADDRESS_BYTES,
    ADDRESS_FIELDS,
    CONFIG_BYTES,
    CONFIG_FIELDS,
    CRC_BYTES,
    GO_BYTES,
    GO_FIELDS,
    PLACE_BYTES,
    PLACE_FIELDS,
    command_fault,
    config_crc,
)
from fiber_bus_bridge.wire.config_blocks import Block, block_at, blocks_fault, read_gears
from fiber_bus_bridge.wire.fields import Bytes, Whole, field_offset, number, signed
from fiber_bus_bridge.wire.replies import (
    IDENTITY_BYTES,
    STATUS_BYTES,
    write_identity,
    write_status,
)
from fiber_bus_bridge.wire.roll_call import write_present

__all__ = ["obey", "receive", "reply", "reply_to_roll_call"]

_LOAD, _GO, _STOP = int(Opcode.LOAD), int(Opcode.GO), int(Opcode.STOP)
_CLEAR, _RESET = int(Opcode.CLEAR), int(Opcode.RESET)
_CONFIG, _IDENTIFY = int(Opcode.CONFIG), int(Opcode.IDENTIFY)
_HEARTBEAT, _ADDRESS = int(Opcode.HEARTBEAT), int(Opcode.ADDRESS)
_PLACE, _MOVES = int(Opcode.PLACE), int(Opcode.MOVES)

_UNCONFIGURED, _IDLE = int(RobotState.UNCONFIGURED), int(RobotState.IDLE)
_LOADED, _MOVING = int(RobotState.LOADED), int(RobotState.MOVING)
_DONE, _STOPPED = int(RobotState.DONE), int(RobotState.STOPPED)
_FAULT = int(RobotState.FAULT)

_NONE = int(Fault.NONE)
_BAD_VERSION, _BAD_VALUE = int(Fault.BAD_VERSION), int(Fault.BAD_VALUE)
_NOT_CONFIGURED, _WRONG_STATE = int(Fault.NOT_CONFIGURED), int(Fault.WRONG_STATE)
_STALE_SEQUENCE, _OTHER_QUANTUM = int(Fault.STALE_SEQUENCE), int(Fault.OTHER_QUANTUM)
_OTHER_GEARS = int(Fault.OTHER_GEARS)
_REFUSED = int(Alert.REFUSED)
_GEARS, _SPEEDS, _RAMPS = int(Block.GEARS), int(Block.SPEEDS), int(Block.RAMPS)

_TICK = field_offset(CONFIG_FIELDS, "tick_us")
_QUANTUM = field_offset(CONFIG_FIELDS, "quantum_prad")
_LIMITS = field_offset(CONFIG_FIELDS, "limits")
_SPEED = field_offset(CONFIG_FIELDS, "speed")
_WATCHDOG = field_offset(CONFIG_FIELDS, "watchdog_ms")
_SILENCE = field_offset(CONFIG_FIELDS, "silence_ms")
_SLOT = field_offset(CONFIG_FIELDS, "slot")
_COUNTDOWN = field_offset(GO_FIELDS, "countdown")
_SERIAL = field_offset(ADDRESS_FIELDS, "serial")
_POSITION = field_offset(PLACE_FIELDS, "position")
_FORM_ADDRESS = field_offset(ADDRESS_FIELDS, "form_address")


@njit(cache=True)
def receive(
    r: Robot, address: int, ten_bit: bool, data: Bytes, first: int, last: int, t: float
) -> bool:
    """Let a robot receive data[first:last], sent to it or to all, complete at time t [s].

    Returns:
        Whether the robot acknowledges the last byte. A refused frame changes nothing but the
        robot's fault and alerts.
    """
    if (address or ten_bit) and last > first and data[first] >> 4 in (_LOAD, _MOVES):
        advance_robot(r, t)
        return not r.busy and _taken(r, _load(r, data, first, last, t))
    fault, head = command_fault(address, ten_bit, data, first, last)
    return obey(r, fault, head, data, first + (address == 0 and not ten_bit), last, t)


@njit(cache=True)
def obey(r: Robot, fault: int, head: Whole, data: Bytes, at: int, last: int, t: float) -> bool:
    """Let a robot receive a frame other than an order, as `receive` does, after it was checked.

    Args:
        r: the robot.
        fault: Fault of the frame, as command_fault returns it.
        head: opcode byte of the frame.
        data: bytes of the frame.
        at: place of its opcode byte.
        last: its end: the frame ends before data[last].
        t: time at which it is complete [s].
    """
    advance_robot(r, t)
    if r.busy:
        return False
    if fault == _NONE:
        opcode, low = head >> 4, head & 15
        if opcode == _GO:
            _go(r, low, number(data, last - GO_BYTES + _COUNTDOWN, 2), t)
        elif opcode == _STOP:
            _stop(r, t)
        elif opcode == _CLEAR:
            fault = _clear(r)
        elif opcode == _RESET:
            reboot(r, t)
        elif opcode == _IDENTIFY:
            r.identity_requested = True
        elif opcode == _HEARTBEAT:
            r.heartbeat_s = t
        elif opcode == _ADDRESS:
            fault = _change_address(r, data, last - ADDRESS_BYTES)
        elif opcode == _PLACE:
            fault = _place(r, data, last - PLACE_BYTES)
        elif opcode == _CONFIG:
            fault = _configure(r, low, data, at, last - CRC_BYTES)
    return _taken(r, fault)


@njit(cache=True)
def _taken(r, fault):
    if fault != _NONE:
        r.fault = fault
        r.alerts |= _REFUSED
    return fault == _NONE


@njit(cache=True)
def reply(r: Robot, t: float, out: Bytes) -> None:
    """Combine a robot's reply to a read at time t [s] with `out`, as wired AND."""
    advance_robot(r, t)
    data = np.empty(STATUS_BYTES, dtype=np.uint8)
    size = STATUS_BYTES
    if r.identity_requested:
        r.identity_requested = False
        write_identity(r.address, r.ten_bit, r.serial, r.boot, data)
        size = IDENTITY_BYTES
    else:
        position = (encoder(r, 0, t), encoder(r, 1, t))
        write_status(
            r.address, r.ten_bit, r.state, r.sequence, verified_crc(r), r.boot,
            r.fault, r.alerts, position, data,
        )  # fmt: skip
        if len(out) >= STATUS_BYTES:
            r.alert_s = np.inf
    for i in range(min(size, len(out))):
        out[i] &= data[i]


@njit(cache=True)
def reply_to_roll_call(r: Robot, t: float, out: Bytes) -> None:
    """Combine a robot's reply to a roll call at time t [s] with `out`, as wired AND."""
    advance_robot(r, t)
    if r.state == _MOVING or r.state == _DONE:
        write_present(r.slot, out)


@njit(cache=True)
def _load(r, data, first, last, t):
    if r.state == _UNCONFIGURED:
        return _NOT_CONFIGURED
    if r.state in (_MOVING, _STOPPED, _FAULT):
        return _WRONG_STATE
    fault = order_refusal(r, data, first, last)
    if fault != _NONE:
        return fault
    sequence = np.int64(data[first]) & 15
    if sequence == r.executed:
        return _STALE_SEQUENCE
    length = last - first
    for i in range(length):
        r.order[i] = data[first + i]
    r.order_length = length
    r.sequence = sequence
    r.loaded_s = t
    r.fault = _NONE
    r.state = _LOADED
    return _NONE


@njit(cache=True)
def _go(r, sequence, countdown, t):
    if r.state == _LOADED and r.sequence == sequence:
        start_order(r, t, countdown * COUNTDOWN_S)
    elif r.executed != sequence:
        r.executed = NOTHING  # another plan began: sequence numbers are reused


@njit(cache=True)
def _stop(r, t):
    halt(r, t)
    if r.state not in (_UNCONFIGURED, _FAULT):
        r.state = _STOPPED


@njit(cache=True)
def _clear(r):
    if r.state == _MOVING:
        return _WRONG_STATE
    r.order_length = 0
    r.fault = _NONE
    r.alerts = 0
    r.alert_s = np.inf
    r.state = _IDLE if r.tick_us else _UNCONFIGURED
    return _NONE


@njit(cache=True)
def _configure(r, version, data, at, last):
    if version != VERSION:
        return _BAD_VERSION
    if r.state == _MOVING:
        return _WRONG_STATE
    velocity_bits, duration_bits = np.int64(data[at + 1]), np.int64(data[at + 2])
    tick_us, quantum = number(data, at + _TICK, 4), number(data, at + _QUANTUM, 4)
    if not (2 <= velocity_bits <= 16 and 1 <= duration_bits <= 16) or tick_us == 0:
        return _BAD_VALUE
    fault = blocks_fault(data, at + CONFIG_BYTES, last, tick_us)
    if fault != _NONE:
        return fault
    if quantum != r.quantum_prad:
        return _OTHER_QUANTUM
    if not _take_gears(r, data, block_at(data, at + CONFIG_BYTES, last, _GEARS)):
        return _OTHER_GEARS
    _take_list(r, data, block_at(data, at + CONFIG_BYTES, last, _SPEEDS))
    _take_ramps(r, data, block_at(data, at + CONFIG_BYTES, last, _RAMPS))
    r.config_crc = config_crc(data, at, last)
    r.tick_us = tick_us
    r.velocity_bits, r.duration_bits = velocity_bits, duration_bits
    for joint in range(2):
        for end in range(2):
            r.limits[joint, end] = signed(data, at + _LIMITS + 8 * joint + 4 * end)
        r.speed[joint] = number(data, at + _SPEED + 2 * joint, 2)
    r.watchdog_s = 1e-3 * number(data, at + _WATCHDOG, 2)
    r.silence_s = 1e-3 * number(data, at + _SILENCE, 2)
    r.slot = number(data, at + _SLOT, 2)
    r.order_length = 0
    r.fault = _NONE
    r.alerts = 0
    r.alert_s = np.inf
    if r.state not in (_STOPPED, _FAULT):
        r.state = _IDLE
    return _NONE


@njit(cache=True)
def _take_gears(r, data, at):
    """Take the limits of the motors from a block, if it tells the gears that the robot has."""
    coupling = np.zeros((2, 2), dtype=np.int64)
    limits, speed = np.zeros((2, 2), dtype=np.int64), np.zeros(2, dtype=np.int64)
    if at >= 0:
        read_gears(data, at, coupling, limits, speed)
    if (at >= 0) != coupling.any() or not np.array_equal(coupling, r.coupling):
        return False
    r.motor_limits[:], r.motor_speed[:] = limits, speed
    return True


@njit(cache=True)
def _take_list(r, data, at):
    """Take the list of speeds from a block that was checked, or that there is none."""
    r.listed_bytes = np.int64(data[at - 1]) if at >= 0 else 0
    for i in range(r.listed_bytes):
        r.listed[i] = data[at + i]


@njit(cache=True)
def _take_ramps(r, data, at):
    """Take the ramps of the motors from a block that was checked, or that there is none."""
    r.ramp_bytes = np.int64(data[at - 1]) if at >= 0 else 0
    for i in range(r.ramp_bytes):
        r.ramps[i] = data[at + i]


@njit(cache=True)
def _change_address(r, data, at):
    if number(data, at + _SERIAL, 4) != r.serial:
        return _NONE  # meant for another robot
    if r.state == _MOVING or r.state == _LOADED:
        return _WRONG_STATE
    form = number(data, at + _FORM_ADDRESS, 2)
    address, ten_bit = form & 0x7FFF, form >> 15 == 1
    if address > (1022 if ten_bit else 0x77) or (not ten_bit and address < 0x08):
        return _BAD_VALUE
    r.address, r.ten_bit = address, ten_bit
    return _NONE


@njit(cache=True)
def _place(r, data, at):
    if r.state == _UNCONFIGURED:
        return _NOT_CONFIGURED
    if r.state not in (_IDLE, _DONE):
        return _WRONG_STATE
    for joint in range(2):
        r.position[joint] = signed(data, at + _POSITION + 4 * joint)
    r.state = _IDLE  # where an order ended is not where the robot is told to be
    return _NONE
