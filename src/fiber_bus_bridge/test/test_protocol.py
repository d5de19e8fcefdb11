# SPDX-License-Identifier: Apache-2.0
"""The table of states and events, and the course of plans through it."""

import numpy as np
import pytest
from session_rig import Rig, ended_once

from fiber_bus_bridge import SessionConfig, SessionState
from fiber_bus_bridge.errors import ProtocolError
from fiber_bus_bridge.protocol import STEPS, TRANSITIONS, Event, State, allows, next_state
from fiber_bus_bridge.simulation import Event as RobotEvent
from fiber_bus_bridge.wire import RobotState

AWAITS = {State.UNCONFIGURED, State.IDLE, State.READY, State.STOPPED, State.INTERRUPTED}


def reached_from(begin):
    seen, todo = set(), [begin]
    while todo:
        state = todo.pop()
        seen.add(state)
        todo += [after for (s, _), after in TRANSITIONS.items() if s is state and after not in seen]
    return seen


def test_every_state_has_a_function_or_awaits_a_call():
    assert set(STEPS) | AWAITS == set(State) and not set(STEPS) & AWAITS
    assert all(step.__doc__ for step in STEPS.values())


def test_every_state_is_reached_and_leads_to_rest():
    assert reached_from(State.UNCONFIGURED) == set(State)
    assert all(State.IDLE in reached_from(state) for state in State)
    assert {event for _, event in TRANSITIONS} == set(Event)


def test_a_step_that_fails_is_known_in_every_state_with_a_function():
    assert {state for state in State if allows(state, Event.ERROR)} == set(STEPS)


def test_robots_are_stopped_from_every_state_in_which_a_call_may_come():
    awaits = AWAITS | {State.MOVING}
    assert {state for state in State if allows(state, Event.STOP)} == awaits


def test_an_unknown_event_is_an_error_with_both_names():
    with pytest.raises(ProtocolError, match="READY does not know GO_SENT, only CLEAR, ENABLE, ST"):
        next_state(State.READY, Event.GO_SENT)


def course(rig):
    transitions = rig.session.take_transitions()
    assert all(a.next_state is b.state for a, b in zip(transitions, transitions[1:]))
    assert all(a.t <= b.t for a, b in zip(transitions, transitions[1:]))
    return [transition.event for transition in transitions]


def test_the_course_of_a_plan_without_faults():
    rig = Rig()
    rig.ready()
    rig.call("start")
    rig.run()
    calls = {Event.ADVANCE, Event.STEPPED}
    assert [event for event in course(rig) if event not in calls] == [
        Event.CONFIGURE,
        Event.CONFIGURED,
        Event.SUBMIT,
        Event.START,
        Event.VERIFIED,
        Event.CERTIFIED,
        Event.GO_SENT,
        Event.CONFIRMED,
        Event.ARRIVED,
        Event.ENDED,
    ]
    assert course(rig) == []


def test_the_course_of_a_plan_with_a_stop_and_a_resume():
    rig = Rig()
    rig.ready()
    rig.call("start")
    rig.robots.schedule([(3, rig.session.loaded_plan.start_s + 0.3, RobotEvent.JAM_THETA, 1)])
    course(rig)
    rig.run()
    assert [event for event in course(rig) if event is not Event.ADVANCE] == [
        Event.FAILURE,
        Event.ABLE,
        Event.RESUMED,
        Event.VERIFIED,
        Event.CERTIFIED,
        Event.GO_SENT,
        Event.CONFIRMED,
        Event.ARRIVED,
        Event.ENDED,
    ]


class BrokenBackendError(Exception):
    """A defect of a backend."""


def break_in(rig, state):
    """Let the first transfer in a state fail once."""
    backend = rig.session.transactions.backend
    transfer = backend.transfer

    def broken(*arguments):
        if rig.session.protocol.state is state:
            backend.transfer = transfer
            raise BrokenBackendError
        return transfer(*arguments)

    backend.transfer = broken


UNDER_WAY = ["LOADING", "CERTIFIED", "COUNTDOWN", "MOVING", "STOPPING", "RESUMING", "HALTING"]


@pytest.mark.parametrize("call", ["advance", "stop"])
@pytest.mark.parametrize("state", UNDER_WAY)
def test_an_exception_in_a_plan_stops_all_robots_at_the_next_call(state, call):
    rig = Rig(7, config=SessionConfig(resumes=int(state != "HALTING")))
    rig.ready()
    rig.robots.schedule([(3, rig.t + 0.1, RobotEvent.JAM_THETA, 1)])
    break_in(rig, State[state])
    with pytest.raises(BrokenBackendError):
        rig.call("start")
        rig.run()
    assert rig.session.protocol.state is State.INTERRUPTED
    assert rig.session.state is SessionState.MOVING
    rig.call(call)
    assert rig.session.state is SessionState.STOPPED
    ended_once(rig.session.result, 7)
    assert set(rig.robots.states(rig.t)) <= {RobotState.STOPPED, RobotState.FAULT}
    at = rig.where()
    rig.t += 5
    assert np.array_equal(rig.where(), at)
    rig.call("clear")
    assert rig.session.state is SessionState.IDLE


@pytest.mark.parametrize(
    ("before", "name", "after"),
    [
        ((), "configure", SessionState.UNCONFIGURED),
        (("configure",), "clear", SessionState.STOPPED),
        (("configure",), "stop", SessionState.MOVING),
    ],
)
def test_an_exception_at_rest_leaves_a_state_from_which_calls_go_on(before, name, after):
    rig = Rig(3)
    for call in before:
        rig.call(call)
    state = {"configure": State.CONFIGURING, "clear": State.CLEARING, "stop": State.HALTING}
    break_in(rig, state[name])
    with pytest.raises(BrokenBackendError):
        rig.call(name)
    assert rig.session.state is after
    rig.call("stop")
    rig.call("clear")
    rig.call("configure")
    assert rig.session.state is SessionState.IDLE and rig.session.known.all()
