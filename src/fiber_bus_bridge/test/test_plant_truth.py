# SPDX-License-Identifier: Apache-2.0
"""The true motion of robots in a plant."""

import numpy as np
import pytest
from plant_rig import (
    PLANE,
    START,
    UNITS,
    begin,
    end,
    finish,
    served,
    session_on,
    turning,
    wait_for,
    without_care,
)

from fiber_bus_bridge.plant import PlantTruth, touching
from fiber_bus_bridge.plant.messages import PlantError
from fiber_bus_bridge.plant.plant import Plant
from fiber_bus_bridge.simulation import Mechanics, SimulationConfig, simulated_buses
from fiber_bus_bridge.wire import (
    Opcode,
    encode_command,
    general_call,
)
from fiber_core.outcomes import Outcome
from fiber_core.wire_units import WireMotion


@pytest.fixture
def path(tmp_path):
    return tmp_path / "plant.sock"


def test_the_truth_is_the_true_motion_and_is_read_without_effect(path):
    with served(path) as plant:
        session, _ = session_on(plant.connect())
        t = begin(session)
        with PlantTruth(path) as reader:
            session.advance(t + 0.1)
            on_the_way = reader.since()
            assert np.isnan(on_the_way.moves.ended_s).all() and len(on_the_way.moves.row) == 19
            t = finish(session, t)
            found = reader.since(on_the_way.next)
            assert found.first == 19 and len(found.moves.row) == 0
            found = reader.since()
        assert found.verified.all() and set(found.controller) == {1}
        assert np.array_equal(found.position, session.counts)
        motion = found.motion()
        assert np.allclose(motion.end, session.angles, atol=UNITS.quantum_rad)
        assert np.allclose(motion.start, UNITS.to_angles(UNITS.to_counts(START)))
        assert not touching(PLANE, found).unsafe.any()
    assert set(session.result.outcome) == {Outcome.REACHED}


def test_a_reader_of_the_truth_finds_the_plant_that_began_anew(path):
    with served(path):
        reader = PlantTruth(path, wait_s=5.0)
    with reader:
        with served(path):
            assert len(reader.since().moves.row) == 0
        reader._wait_s = 0.1
        with pytest.raises(PlantError, match="no plant at"):
            reader.since()


def test_arms_that_touch_are_found_in_the_truth(path):
    with served(path) as plant:
        session, _ = session_on(plant.connect(), certify=without_care)
        session.configure(0.0)
        # every arm is stretched, every second one turns around
        turns = np.where(np.arange(PLANE.n) % 2, 3000, 0)
        velocity = np.stack([turns, np.full(PLANE.n, -2000)], axis=1).ravel()
        offsets, ticks = np.arange(2 * PLANE.n + 1), np.full(2 * PLANE.n, 600)
        session.submit(WireMotion(UNITS, session.counts, offsets, ticks, velocity))
        finish(session, session.start(1.0))
        with PlantTruth(path) as reader:
            truth = reader.since()
        found = touching(PLANE, truth)
        assert found.unsafe.any() and found.min_gap_mm < 0
        # contacts are those of the true arms: these are stuck, whatever their counters read
        stuck = Mechanics.ideal(PLANE.n).with_(stuck_from=np.zeros((PLANE.n, 2)))
        assert not touching(PLANE, truth, stuck).unsafe.any()
        assert touching(PLANE, truth, Mechanics.ideal(PLANE.n)).min_gap_mm == found.min_gap_mm
        with pytest.raises(PlantError, match="before movement 7: ask from 0 on"):
            truth._replace(first=7).motion(stuck)


def test_orders_of_a_dead_bridge_or_never_read_back_count_as_unverified(path):
    with served(path, time_scale=1e-6, patience_s=1e6) as plant:
        session, _ = session_on(plant.connect(), certify=end)
        t = session.configure(0.0)
        session.submit(turning(session))
        with pytest.raises(KeyboardInterrupt):
            session.start(t)
        session.transactions.backend.buses.close()
        wait_for(lambda: not plant.plant.connected)
        other, _ = session_on(plant.connect())
        # the GO of the next bridge, under the sequence number of the dead one
        buses = other.transactions.buses
        sequence = int(plant.buses.positioners.memory["sequence"][0])
        frames = encode_command(Opcode.GO, general_call(buses), sequence, 100)
        other.transactions.transfer(frames, 0, 0.0)
        with PlantTruth(path) as reader:
            found = reader.since()
        assert len(found.moves.row) == PLANE.n
        assert set(found.controller) == {2} and not found.verified.any()


def test_old_movements_are_forgotten_and_the_motion_still_begins_where_it_did():
    buses = simulated_buses(PLANE, UNITS, START, SimulationConfig())
    plant = Plant(buses, UNITS.quantum_rad, kept=1)

    class Direct:
        def transfer(self, frames, read, before):
            read = np.broadcast_to(np.asarray(read), (len(frames),))
            return plant.transfer(frames, read, before, 0.0)

        def recover(self, bus, recovery, t):
            return buses.recover(bus, recovery, t)

        def alert_lines(self, t):
            return buses.alert_lines(t)

    session, _ = session_on(Direct())
    t = session.configure(0.0)
    for k in range(6):
        before = session.counts.copy()
        session.submit(turning(session, speed=400 * (-1) ** k))
        t = finish(session, session.start(t))
    assert plant.truth.count == 6 * PLANE.n and plant.truth.forgotten >= 2 * PLANE.n
    first, start, moves, controller, verified = plant.true_movements(5 * PLANE.n)
    assert first == 5 * PLANE.n and np.array_equal(start, before)
    assert np.array_equal(moves.motion(start, UNITS.quantum_rad, t).end.shape, (PLANE.n, 2))
    assert len(controller) == PLANE.n and verified.all()
