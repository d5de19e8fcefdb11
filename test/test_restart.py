# SPDX-License-Identifier: Apache-2.0
"""A restart of the bridge beside robots that fell silent in motion: no arms touch in the truth."""

import numpy as np
import pytest

from fiber_bus_bridge import Session, SessionState, addresses_of
from fiber_bus_bridge.robot_memory import load_memory, save_memory
from fiber_bus_bridge.simulation import ObservedBuses, Positioners, SimulatedBuses, TrueMotion
from fiber_bus_bridge.wire import RobotState
from fiber_core.clearance import Safety, certify, neighbour_pairs
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_positioners import make_orders, random_problem

pytestmark = pytest.mark.timeout(900)

ROBOTS, SILENT, TRIALS = 91, 3, 25


class Night:
    """A plane with silent robots, whose bridge is restarted between two plans.

    Args:
        seed: seed of the problems and of the robots that fall silent.
        path: file of the memory of the robots, None for no memory.
    """

    def __init__(self, seed, path):
        self.rng, self.path = np.random.default_rng([seed, 13]), path
        self.problem = random_problem(preset("desi", ROBOTS), self.rng)
        self.orders = make_orders(self.problem)
        self.plane, units = self.orders.plane, self.orders.units
        robots = Positioners(
            addresses_of(self.plane), self.plane.ids, units.quantum_prad, self.orders.counts
        )
        self.robots, self.truth = robots, TrueMotion(robots, units.quantum_rad)
        self.buses = ObservedBuses(SimulatedBuses(robots), self.truth)
        self.t, self.silent = 0.0, np.zeros(0, dtype=np.int64)

    def restart(self):
        """A new session, which begins with what problem.npz says and with the memory."""
        units = self.orders.units
        assumed = units.to_angles(self.orders.counts)
        self.session = Session(self.plane, units, Safety(), self.buses, assumed)
        if self.path is not None:
            memory = load_memory(self.path, self.plane, units.quantum_prad, len(self.session.buses))
            if memory is not None:
                self.session.recall(memory)
        self.t = self.session.configure(self.t)
        if self.session.state is SessionState.STOPPED:
            self.t = self.session.clear(self.t)

    def save(self, starting=False):
        if self.path is not None:
            nothing = np.full(self.plane.n, Reason.OK, dtype=np.int64)
            memory = self.session.memory(nothing, starting)
            save_memory(self.path, memory, self.plane, self.orders.units.quantum_prad)
        return True

    def plan(self, orders, lose=0):
        """Carry out orders; in the middle of the motion some robots lose power."""
        session = self.session
        session.submit(orders.wire, orders.targets)
        self.t = session.start(self.t, lambda: self.save(starting=True))
        if lose:
            self.t = session.advance(self.t + self.rng.uniform(0.2, 0.8))
            moving = np.flatnonzero(self.robots.memory["state"] == RobotState.MOVING)
            self.silent = self.rng.choice(moving, lose, replace=False)
            self.robots.power(self.silent, False, self.t)
            return
        while session.state is SessionState.MOVING:
            self.t = session.advance(self.t + 0.1)
        self.result = session.take_result()
        self.save()

    def next_orders(self):
        """Orders for a random plan, from where the session believes that the robots are."""
        plane = self.plane.with_enabled(self.session.known)
        targets = random_problem(self.plane, self.rng).targets
        return make_orders(Problem(plane, self.session.angles, targets))

    def touching(self):
        """Return pairs of robots that touched, in continuous time, by their outlines."""
        plane, none = self.plane, Safety(0.0, 0.0, 0.0, 0.0)
        truth = certify(plane, self.truth.motion(self.t + 1.0), none, neighbour_pairs(plane))
        return truth.pairs[truth.unsafe]


class Killed(BaseException):
    """The bridge dies; nothing of its program catches that."""


def killed_before_the_resume(path, remembers=True):
    """A night whose bridge has stopped all robots after a failure, and dies before they resume.

    Without `remembers` it dies before it has written its memory again, too.
    """
    made, asked = Night(2, path), []
    made.restart()

    def may_go():
        asked.append(made.session.protocol.state)
        if len(asked) == 1 or remembers:
            made.save(starting=True)
        if len(asked) > 1:
            raise Killed
        return True

    made.session.submit(made.orders.wire, made.orders.targets)
    made.t = made.session.start(made.t, may_go)
    made.t = made.session.advance(made.t + 0.5)
    moving = np.flatnonzero(made.robots.memory["state"] == RobotState.MOVING)
    made.robots.power(moving[:1], False, made.t)
    with pytest.raises(Killed):
        for _ in range(100):
            made.t = made.session.advance(made.t + 0.1)
    assert [state.name for state in asked] == ["CERTIFIED", "STOPPING"]
    assert (made.robots.memory["state"] == RobotState.STOPPED).sum() > ROBOTS / 2
    made.t += 1.0
    return made


def new_session(made):
    """The state in which a new session finds the robots."""
    units = made.orders.units
    session = Session(made.plane, units, Safety(), made.buses, units.to_angles(made.orders.counts))
    session.recall(load_memory(made.path, made.plane, units.quantum_prad, len(session.buses)))
    session.configure(made.t)
    made.session = session
    return session.state


@pytest.mark.parametrize("remembers", [True, False])
def test_a_bridge_that_dies_between_its_own_stop_and_the_resume_needs_no_clear(tmp_path, remembers):
    made = killed_before_the_resume(tmp_path / "robots.json", remembers)
    assert new_session(made) is SessionState.IDLE
    assert not (made.robots.memory["state"] == RobotState.STOPPED).any()
    made.plan(made.next_orders())
    assert not len(made.touching()) and (made.result.outcome == 0).sum() > ROBOTS / 2


def test_a_stop_of_an_operator_waits_for_one(tmp_path):
    made = killed_before_the_resume(tmp_path / "robots.json")
    made.t = made.session.stop(made.t)
    made.save()
    assert new_session(made) is SessionState.STOPPED


def night(seed, path, believe=False):
    """Two plans with a restart between; return the night."""
    made = Night(seed, path)
    made.restart()
    made.plan(made.orders, lose=SILENT)
    made.t += 1.0  # the bridge is gone: robots without heartbeats stop by themselves
    made.restart()
    if believe:  # as before: all stand where problem.npz says
        made.session.vouch(made.plane.ids[made.silent])
    made.plan(made.next_orders())
    return made


@pytest.mark.parametrize("with_memory", [True, False])
def test_after_a_restart_no_robot_is_driven_through_one_that_fell_silent(tmp_path, with_memory):
    moved = []
    for seed in range(TRIALS if with_memory else TRIALS // 5):
        made = night(seed, tmp_path / f"{seed}.json" if with_memory else None)
        assert not len(made.touching()), seed
        assert made.session.robots["lost"][made.silent].all()
        moved.append((made.result.outcome == 0).sum())
    # the others go on
    assert np.mean(moved) > ROBOTS / 2


def test_the_judge_sees_contacts_when_silent_robots_are_believed():
    nights = (night(seed, None, believe=True) for seed in range(TRIALS))
    assert any(len(made.touching()) for made in nights)


def test_a_robot_that_answers_again_is_believed_and_its_neighbours_move(tmp_path):
    made = Night(0, tmp_path / "robots.json")
    made.restart()
    made.plan(made.orders, lose=SILENT)
    made.t += 1.0
    made.robots.power(made.silent, True, made.t)
    made.restart()
    lost, counts = made.session.robots["lost"], made.session.counts
    assert not lost.any() and made.session.known.all()
    np.testing.assert_array_equal(counts, made.robots.memory["position"])


def test_the_first_plan_after_a_restart_beside_powered_robots_is_not_refused(tmp_path):
    """The robots keep the sequence number that they executed last."""
    made = Night(1, None)
    made.restart()
    made.plan(made.orders)
    before = made.session.buses["sequence"].copy()
    made.restart()
    assert np.array_equal(made.session.buses["sequence"], before)
    made.plan(made.next_orders())
    assert not (made.result.reason == Reason.REFUSED).any()
    assert (made.result.outcome == 0).sum() > ROBOTS / 2
