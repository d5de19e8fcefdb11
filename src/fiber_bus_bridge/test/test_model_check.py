# SPDX-License-Identifier: Apache-2.0
"""The model check of the protocol: no rule is broken, and planted mistakes are found."""

import numpy as np
import pytest

from fiber_bus_bridge.protocol import STEPS, Event, State, ending, loading, starting, stopping
from fiber_bus_bridge.simulation.model_check import Choices, Scenario, System, explore
from fiber_core.clearance import Safety
from fiber_core.outcomes import Outcome, Reason

TWO_AND_TWO = Scenario(buses=2, robots=2)
# without their own protection robots depend on the messages alone
UNPROTECTED = Scenario(buses=2, robots=1, silence_ms=0, stuck=False)


@pytest.mark.parametrize("scenario", [TWO_AND_TWO, Scenario(resumes=0), UNPROTECTED])
def test_no_single_fault_breaks_a_rule(scenario):
    search = explore(scenario, faults=1)
    assert search.wrong == [] and search.complete
    assert search.states > 1000 and set(search.ends) == {"IDLE", "STOPPED"}
    assert search.apart_s <= Safety().stop_skew_s


def test_the_search_visits_every_state_of_a_plan():
    at_rest = {State.UNCONFIGURED, State.CONFIGURING, State.READY, State.CLEARING}
    assert explore(Scenario(), faults=1).visited == set(State) - at_rest


def test_a_search_repeats_itself():
    searches = [explore(Scenario(), faults=1, most_steps=500) for _ in range(2)]
    assert searches[0] == searches[1] and not searches[0].complete


def test_states_that_differ_in_the_time_of_day_alone_are_one():
    system = System.begin(Scenario())
    later = system.clone()
    for each in (system, later):
        while each.c.state is not State.CERTIFIED:
            each.step(Choices())
    assert later.key() == system.key()
    later.c.now_s += 3.0
    assert later.key() != system.key()
    later.c.transactions.free_s += 3.0
    later.buses.free_s += 3.0
    assert later.key() == system.key()
    later.buses.memory["sequence"][1] += 1
    assert later.key() != system.key()


def without_verify(patch):
    def deliver(c, phase, rows, frames):
        c.transactions.send(rows, frames, phase.t)
        everyone = np.ones(len(rows), dtype=bool)
        return loading.Delivery(everyone, ~everyone, np.full(len(rows), Reason.OK))

    patch.setattr(loading, "deliver", deliver)


def against_the_certificate(patch):
    certify = STEPS[State.VERIFIED]
    patch.setitem(STEPS, State.VERIFIED, lambda c: certify(c) and Event.CERTIFIED)


def without_confirmation(patch):
    def count_down(c):
        c.watch.ends_s = c.phase.start_s + loading.commit(c, c.phase).makespan_s
        return Event.CONFIRMED

    patch.setitem(STEPS, State.COUNTDOWN, count_down)


def with_a_late_go(patch):
    def go(c):
        c.phase.late = None
        event = real_go(c)
        return Event.GO_SENT if event is Event.GO_LATE else event

    real_go = STEPS[State.CERTIFIED]
    patch.setitem(STEPS, State.CERTIFIED, go)


def asked_instead_of_stopped(c, rows, t):
    return c.transactions.statuses(rows, t)


def cancelled_without_stop(patch):
    patch.setattr(starting, "stop_all", asked_instead_of_stopped)


def resumed_without_stop(patch):
    patch.setattr(stopping, "stop_all", asked_instead_of_stopped)


def every_robot_praised(patch):
    def evaluate(plane, *arguments):
        result = real_evaluate(plane, *arguments)
        result.outcome[:], result.reason[:] = Outcome.REACHED, Reason.OK
        return result

    real_evaluate = ending.evaluate
    patch.setattr(ending, "evaluate", evaluate)


def no_outcome(patch):
    patch.setattr(ending, "evaluate", lambda *arguments: None)


def never_loaded(patch):
    patch.setitem(STEPS, State.LOADING, lambda c: Event.SUSPECT)


def loaded_for_ever(patch):
    patch.setattr(loading, "_ROUNDS", 10**6)
    patch.setattr(starting, "unresponsive", lambda robots, *rest: np.zeros(len(robots), bool))
    patch.setitem(STEPS, State.COUNTDOWN, lambda c: Event.UNCONFIRMED)


PLANTED = [
    (without_verify, Scenario(), "counts down with an order that is not certified"),
    (against_the_certificate, Scenario(), "counts down with an order that is not certified"),
    (without_confirmation, Scenario(), "does not count down, and the others start"),
    (with_a_late_go, Scenario(), "ms apart"),
    (cancelled_without_stop, UNPROTECTED, "moves after the end of the plan"),
    (resumed_without_stop, Scenario(), "moves after a stop"),
    (resumed_without_stop, UNPROTECTED, "moves after the end of the plan"),
    (every_robot_praised, Scenario(), "has outcome 0, reason 0"),
    (no_outcome, Scenario(), "not every robot has one outcome"),
    (never_loaded, Scenario(), "does not end"),
    (loaded_for_ever, Scenario(), "does not end"),
]


ENDLESS = (never_loaded, loaded_for_ever)  # without a fault


@pytest.mark.parametrize(("plant", "scenario", "rule"), PLANTED)
def test_a_planted_mistake_is_found(plant, scenario, rule, monkeypatch):
    plant(monkeypatch)
    search = explore(scenario, faults=int(plant not in ENDLESS), most_wrong=25)
    found = [wrong for wrong in search.wrong if rule in wrong]
    assert found, search
