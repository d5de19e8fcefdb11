# SPDX-License-Identifier: Apache-2.0
"""States and events of the protocol, and the table that says which state follows.

A new step of the protocol is a state, its rows in `TRANSITIONS`, and one function in `steps`.
"""

from enum import Enum
from typing import TypeAlias

from fiber_bus_bridge.errors import ProtocolError

__all__ = ["TRANSITIONS", "Event", "State", "allows", "next_state"]


class State(Enum):
    """State of the protocol; the value says what is done, or awaited, in it."""

    UNCONFIGURED = "no robot is configured"
    CONFIGURING = "identify the robots and configure them"
    IDLE = "robots are configured and at rest"
    READY = "orders wait for their start"
    LOADING = "LOAD and VERIFY under fresh sequence numbers"
    VERIFIED = "certify the orders that the robots hold"
    DISARMING = "replace the orders of unsafe robots by empty ones"
    CERTIFIED = "ask whether to start, then send GO"
    COUNTDOWN = "poll until all robots have confirmed the GO"
    CANCELLING = "STOP and CLEAR before one robot has moved"
    DROPPING = "CLEAR all orders that were loaded"
    MOVING = "heartbeats, roll calls and polls, one step at a time"
    STOPPING = "STOP all robots together, after a failure"
    RESUMING = "make orders for the remaining motion"
    ENDING = "evaluate the plan"
    HALTING = "STOP all robots and end the plan"
    STOPPED = "robots are stopped and wait for CLEAR"
    CLEARING = "delete orders and faults"
    INTERRUPTED = "a step raised an exception; the next call stops all robots"


class Event(Enum):
    """What takes the protocol from one state to the next; the value says when."""

    # calls
    CONFIGURE = "configure is called"
    SUBMIT = "orders are submitted"
    START = "start is called"
    ADVANCE = "advance is called"
    STOP = "stop is called"
    CLEAR = "clear is called"
    ENABLE = "enable is called"

    # results of steps
    CONFIGURED = "robots were asked and configured"
    FOUND_STOPPED = "a configured robot was found stopped by a STOP"
    FOUND_ALONE = "configured robots were found that stopped without a controller, all at rest"
    VERIFIED = "every bus with robots to start holds verified orders"
    SUSPECT = "a robot may hold another order: its bus needs a fresh sequence number"
    EXHAUSTED = "no sequence numbers are left to try"
    UNSAFE = "the certificate holds robots back"
    CERTIFIED = "the verified orders are certified"
    ARMED = "an unsafe robot may still hold its order: its bus is loaded again"
    REFUSED = "the caller refuses the start"
    NONE_LEFT = "no robot is left to start"
    GO_SENT = "GO is on all buses"
    GO_LATE = "a bus received the GO too late"
    POLLED = "some robots have not confirmed the GO yet"
    CONFIRMED = "all robots count down"
    UNCONFIRMED = "a robot failed in the countdown, or did not confirm in time"
    CANCELLED = "the robots to load again have confirmed that they are stopped"
    DROPPED = "loaded orders are deleted"
    STEPPED = "robots move"
    ARRIVED = "all robots have arrived"
    OVERDUE = "robots have not arrived in time"
    FAILURE = "a robot or bus failed: all robots must stop"
    ABLE = "robots are stopped and the others may resume"
    UNABLE = "no further resume is allowed"
    RESUMED = "orders for the remaining motion are made"
    ENDED = "every robot has one outcome"
    HALTED = "robots are stopped and the plan has ended"
    CLEARED = "robots are cleared"
    NONE_KNOWN = "no robot is configured"
    ERROR = "the step raised an exception"


S, E = State, Event
_AT_REST = (S.UNCONFIGURED, S.IDLE, S.READY, S.STOPPED)
_UNDER_WAY = (S.LOADING, S.VERIFIED, S.DISARMING, S.CERTIFIED, S.COUNTDOWN, S.CANCELLING)
_UNDER_WAY += (S.DROPPING, S.MOVING, S.STOPPING, S.RESUMING, S.ENDING)
_Table: TypeAlias = dict[tuple[State, Event], State]

# (state, event): the state that follows
TRANSITIONS: _Table = {
    (S.UNCONFIGURED, E.CONFIGURE): S.CONFIGURING,
    (S.IDLE, E.CONFIGURE): S.CONFIGURING,
    (S.CONFIGURING, E.CONFIGURED): S.IDLE,
    (S.CONFIGURING, E.FOUND_STOPPED): S.STOPPED,
    (S.CONFIGURING, E.FOUND_ALONE): S.CLEARING,
    (S.CONFIGURING, E.ERROR): S.UNCONFIGURED,
    (S.IDLE, E.SUBMIT): S.READY,
    (S.READY, E.SUBMIT): S.READY,
    (S.READY, E.START): S.LOADING,
    # start
    (S.LOADING, E.VERIFIED): S.VERIFIED,
    (S.LOADING, E.SUSPECT): S.LOADING,
    (S.LOADING, E.EXHAUSTED): S.DROPPING,
    (S.VERIFIED, E.CERTIFIED): S.CERTIFIED,
    (S.VERIFIED, E.UNSAFE): S.DISARMING,
    (S.DISARMING, E.CERTIFIED): S.CERTIFIED,
    (S.DISARMING, E.ARMED): S.LOADING,
    (S.CERTIFIED, E.REFUSED): S.DROPPING,
    (S.CERTIFIED, E.NONE_LEFT): S.ENDING,
    (S.CERTIFIED, E.GO_SENT): S.COUNTDOWN,
    (S.CERTIFIED, E.GO_LATE): S.CANCELLING,
    (S.COUNTDOWN, E.POLLED): S.COUNTDOWN,
    (S.COUNTDOWN, E.CONFIRMED): S.MOVING,
    (S.COUNTDOWN, E.UNCONFIRMED): S.CANCELLING,
    (S.CANCELLING, E.CANCELLED): S.LOADING,
    (S.DROPPING, E.DROPPED): S.ENDING,
    # motion
    (S.MOVING, E.ADVANCE): S.MOVING,
    (S.MOVING, E.STEPPED): S.MOVING,
    (S.MOVING, E.ARRIVED): S.ENDING,
    (S.MOVING, E.OVERDUE): S.HALTING,
    (S.MOVING, E.FAILURE): S.STOPPING,
    (S.STOPPING, E.ABLE): S.RESUMING,
    (S.STOPPING, E.UNABLE): S.HALTING,
    (S.RESUMING, E.RESUMED): S.LOADING,
    (S.ENDING, E.ENDED): S.IDLE,
    # stop
    (S.HALTING, E.HALTED): S.STOPPED,
    (S.HALTING, E.ERROR): S.INTERRUPTED,
    (S.INTERRUPTED, E.ADVANCE): S.HALTING,
    (S.IDLE, E.CLEAR): S.CLEARING,
    (S.READY, E.CLEAR): S.CLEARING,
    (S.STOPPED, E.CLEAR): S.CLEARING,
    (S.CLEARING, E.CLEARED): S.IDLE,
    (S.CLEARING, E.NONE_KNOWN): S.UNCONFIGURED,
    (S.CLEARING, E.ERROR): S.STOPPED,
}
TRANSITIONS |= {(state, E.STOP): S.HALTING for state in (*_AT_REST, S.MOVING, S.INTERRUPTED)}
TRANSITIONS |= {(state, E.ENABLE): state for state in _AT_REST}
TRANSITIONS |= {(state, E.ERROR): S.INTERRUPTED for state in _UNDER_WAY}


def allows(state: State, event: Event) -> bool:
    """Return whether an event can happen in a state."""
    return (state, event) in TRANSITIONS


def next_state(state: State, event: Event) -> State:
    """Return the state that follows.

    Raises:
        ProtocolError: the state does not know the event.
    """
    if (state, event) not in TRANSITIONS:
        known = sorted(e.name for s, e in TRANSITIONS if s is state)
        raise ProtocolError(f"{state.name} does not know {event.name}, only {', '.join(known)}")
    return TRANSITIONS[state, event]
