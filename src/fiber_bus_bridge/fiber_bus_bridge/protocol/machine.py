# SPDX-License-Identifier: Apache-2.0
"""The machine: runs the function of each state, and enters the state that its event leads to."""

from collections.abc import Callable
from functools import wraps

import numpy as np

from fiber_bus_bridge.protocol import ending, loading, moving, starting, stopping
from fiber_bus_bridge.protocol.context import Context, Phase, Watch
from fiber_bus_bridge.protocol.states import Event, State, next_state

__all__ = ["STEPS", "handle", "run", "run_one"]


def _of_phase(step: Callable[[Context, Phase], Event]) -> Callable[[Context], Event]:
    @wraps(step)
    def run_step(c: Context) -> Event:
        assert c.phase is not None  # a phase is under way in this state
        return step(c, c.phase)

    return run_step


def _of_watch(step: Callable[[Context, Phase, Watch], Event]) -> Callable[[Context], Event]:
    @wraps(step)
    def run_step(c: Context) -> Event:
        assert c.phase is not None and c.watch is not None  # robots have received their GO
        return step(c, c.phase, c.watch)

    return run_step


# the function of each state in which something is done; in the other states a call is awaited
STEPS: dict[State, Callable[[Context], Event]] = {
    State.CONFIGURING: ending.configure,
    State.LOADING: _of_phase(loading.load),
    State.VERIFIED: _of_phase(loading.certify),
    State.DISARMING: _of_phase(loading.disarm),
    State.CERTIFIED: _of_phase(starting.go),
    State.COUNTDOWN: _of_watch(starting.count_down),
    State.CANCELLING: _of_watch(starting.cancel),
    State.DROPPING: _of_phase(loading.drop),
    State.MOVING: _of_watch(moving.move),
    State.STOPPING: _of_watch(stopping.stop),
    State.RESUMING: _of_phase(stopping.resume),
    State.ENDING: ending.end,
    State.HALTING: stopping.halt,
    State.CLEARING: ending.clear,
}


def handle(c: Context, event: Event) -> None:
    """Enter the state that follows an event.

    Raises:
        ProtocolError: the state does not know the event.
    """
    c.record(event, next_state(c.state, event))


def run_one(c: Context) -> None:
    """Run the function of the present state, and enter the state that follows."""
    try:
        event = (c.steps.get(c.state) or STEPS[c.state])(c)
    except BaseException:
        handle(c, Event.ERROR)
        raise
    handle(c, event)


def run(c: Context, until_s: float = np.inf) -> None:
    """Run until a call is awaited, until robots begin to move, or until a time.

    Args:
        c: the controller.
        until_s: while robots move, no step begins at this time or later [s].
    """
    while c.state in STEPS:
        before = c.state
        if before is State.MOVING and c.watch is not None and c.watch.now_s >= until_s:
            return
        run_one(c)
        if c.state is State.MOVING and before is not State.MOVING:
            return  # robots begin to move, also after a stop: the caller may have changed its mind
