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

VERSION = 2  # travels in CONFIG and in the identity; a robot refuses any other
MAX_SEGMENTS = 15  # segments of one joint that one order can carry: a 4-bit count
CALL_PREFIX = 0xF1  # first byte of our general calls; an odd one, as the I2C standard asks of them

COUNTDOWN_S = 1e-5  # unit of the countdown of a GO [s]


class Opcode(IntEnum):
    """What a frame asks for: the high four bits of its first byte."""

    LOAD = 1  # store a placement order
    GO = 2  # start the stored order of this sequence number after a countdown
    STOP = 3  # freeze now
    CLEAR = 4  # forget the stored order and the fault
    RESET = 5  # reboot
    CONFIG = 6  # units, limits, speeds, watchdog
    IDENTIFY = 7  # answer the read that follows with the identity
    HEARTBEAT = 8  # the controller is there: moving robots may go on
    ADDRESS = 9  # the robot of this serial number listens elsewhere from now on


class RobotState(IntEnum):
    """What a positioner is doing. 0 and 15 stay unused: a stuck bus reads as all zeros or ones."""

    UNCONFIGURED = 1
    IDLE = 2
    LOADED = 3
    MOVING = 4
    DONE = 5
    STOPPED = 6
    FAULT = 7


class Fault(IntEnum):
    """Why a frame is not accepted, or what is wrong with a robot."""

    NONE = 0

    # the frame itself
    BAD_LENGTH = 1
    BAD_OPCODE = 2
    BAD_CRC = 3
    BAD_DURATION = 4  # a segment of no ticks
    BAD_VELOCITY = 5  # the one velocity whose opposite does not fit the field
    BAD_PADDING = 6  # bits that must be zero are not
    BAD_VERSION = 7
    BAD_VALUE = 8  # a configuration no robot can work with

    # the frame is fine and the robot refuses it
    NOT_CONFIGURED = 16
    WRONG_STATE = 17
    STALE_SEQUENCE = 18  # an order it has already executed
    OVER_SPEED = 19
    OUTSIDE_LIMITS = 20
    OTHER_QUANTUM = 21  # its encoder does not count in the quanta configured

    # the robot
    WATCHDOG = 32  # an order waited too long for its GO
    MEMORY = 33  # the stored order is no longer what was accepted
    STALL = 34  # a joint does not follow
    SILENCE = 35  # no HEARTBEAT for too long while moving


class Alert(IntFlag):
    """What a robot wants known; polled with STATUS, taken back by CLEAR or CONFIG.

    All but REFUSED and LAPSED also pull the alert line of the bus, where there is one.
    """

    REFUSED = 1  # it refused a frame
    LAPSED = 2  # it dropped an order that was never started
    REBOOTED = 4  # it lost its configuration
    STALLED = 8  # a joint does not follow: both were stopped
    SILENT = 16  # it heard no HEARTBEAT and stopped itself
