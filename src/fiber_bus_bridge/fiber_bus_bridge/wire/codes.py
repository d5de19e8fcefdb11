# SPDX-License-Identifier: Apache-2.0
"""The numbers of the wire format: opcodes, robot states, faults, alerts, limits."""

from enum import IntEnum, IntFlag

__all__ = [
    "CALL_PREFIX",
    "COUNTDOWN_S",
    "MAX_SEGMENTS",
    "VERSION",
    "Alert",
    "Fault",
    "Opcode",
    "RobotState",
]

VERSION = 4  # travels in CONFIG and in the identity; a robot refuses any other
MAX_SEGMENTS = 15  # segments of one joint that one order can carry: a 4-bit count
CALL_PREFIX = 0xF1  # first byte of our general calls; odd, as the I2C standard requires

COUNTDOWN_S = 1e-5  # unit of the countdown of a GO [s]


class Opcode(IntEnum):
    """The command of a frame: the high four bits of its first byte."""

    LOAD = 1  # store an order
    GO = 2  # start the stored order of this sequence number after a countdown
    STOP = 3  # freeze now
    CLEAR = 4  # forget the stored order and the fault
    RESET = 5  # reboot
    CONFIG = 6  # units, limits, speeds, watchdog, gears, lists of speeds
    IDENTIFY = 7  # the read that follows is answered with the identity
    HEARTBEAT = 8  # the controller is present: moving robots may go on
    ADDRESS = 9  # the robot of this serial number takes another address
    PLACE = 10  # the joints are at these encoder readings
    MOVES = 11  # store an order of moves at listed speeds


class RobotState(IntEnum):
    """State of a positioner. 0 and 15 stay unused: a stuck bus reads as all zeros or ones."""

    UNCONFIGURED = 1
    IDLE = 2
    LOADED = 3
    MOVING = 4
    DONE = 5
    STOPPED = 6
    FAULT = 7


class Fault(IntEnum):
    """Why a robot refuses a frame, or what is wrong with the robot."""

    NONE = 0

    # the frame itself
    BAD_LENGTH = 1
    BAD_OPCODE = 2
    BAD_CRC = 3
    BAD_DURATION = 4  # a segment of zero ticks
    BAD_VELOCITY = 5  # the most negative velocity: its opposite does not fit the field
    BAD_PADDING = 6  # bits that must be zero are not
    BAD_VERSION = 7
    BAD_VALUE = 8  # a configuration that no robot can use

    # the frame is well-formed and the robot refuses it
    NOT_CONFIGURED = 16
    WRONG_STATE = 17
    STALE_SEQUENCE = 18  # an order that the robot has already executed
    OVER_SPEED = 19
    OUTSIDE_LIMITS = 20
    OTHER_QUANTUM = 21  # the encoder does not count in the configured quanta
    OTHER_GEARS = 22  # the joints are not coupled as configured
    UNLISTED_SPEED = 23  # a speed that is not in the list of the motor
    SHORT_MOVE = 24  # a move shorter than the least one of its speed

    # the robot
    WATCHDOG = 32  # an order waited too long for its GO
    MEMORY = 33  # the stored order differs from the accepted one
    STALL = 34  # a joint does not follow
    SILENCE = 35  # no HEARTBEAT for too long while moving


class Alert(IntFlag):
    """Flags by which a robot asks to be read; polled with STATUS, reset by CLEAR or CONFIG.

    All but REFUSED and LAPSED also pull the alert line of the bus, where there is one.
    """

    REFUSED = 1  # the robot refused a frame
    LAPSED = 2  # the robot dropped an order that was never started
    REBOOTED = 4  # the robot booted and lost its configuration
    STALLED = 8  # a joint does not follow: both were stopped
    SILENT = 16  # the robot received no HEARTBEAT and stopped itself
