# SPDX-License-Identifier: Apache-2.0
"""The plant as a process of its own: the same bytes, and a time of its own."""

import os
import time

import numpy as np
import pytest
from plant_rig import (
    LONG_S,
    PLANE,
    START,
    UNITS,
    FakeTime,
    begin,
    end,
    finish,
    moving,
    served,
    session_on,
    turning,
    wait_for,
)

from fiber_bus_bridge import SessionState, addresses_of, bus_timing
from fiber_bus_bridge.plant import PlantBuses, PlantTruth
from fiber_bus_bridge.plant.messages import REQUESTS, Kind, PlantError, pack
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses
from fiber_bus_bridge.wire import (
    Addresses,
    Fault,
    RobotState,
)
from fiber_core.outcomes import Outcome

FAULTS = "noise,stall,busy,arbitration,brown_out,scl_stuck"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "plant.sock"


def traffic(tap):
    """All that went over the buses, as bytes, with its times."""
    return [
        [
            part.tobytes()
            for part in (
                each.frames.to.bus, each.frames.to.address, each.frames.to.ten_bit,
                each.frames.offsets, each.frames.data, each.replies.ack, each.replies.start_s,
                each.replies.end_s, each.replies.offsets, each.replies.data,
            )
        ]
        for each in tap.exchanges
    ]  # fmt: skip


@pytest.mark.parametrize("faults", ["", FAULTS])
@pytest.mark.parametrize("seed", [1, 2])
def test_traffic_is_the_same_to_the_byte_with_and_without_a_process(path, faults, seed):
    config = SimulationConfig(seed=seed, faults=faults, faults_from_s=0.0, faults_until_s=0.6)
    session, here = session_on(simulated_buses(PLANE, UNITS, START, config))
    t = finish(session, begin(session))
    with served(path, config) as plant:
        other, there = session_on(plant.connect())
        assert finish(other, begin(other)) == t
    assert len(here.exchanges) > 100
    assert traffic(here) == traffic(there)
    assert np.array_equal(session.counts, other.counts)


@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_robots_stop_by_their_watchdogs_when_the_bridge_is_gone(path, scale):
    clock = FakeTime()
    with served(path, clock=clock, time_scale=scale, patience_s=1e6) as plant:
        session = moving(plant, ticks=1000)
        end = session.loaded_plan.motion.end
        gone_s = plant.plant.now_s
        session.transactions.backend.buses.close()
        if scale:
            wait_for(lambda: not plant.plant.connected)
            assert plant.plant.moving == PLANE.n, "the machine's time has not gone on"
            clock.now_s += 0.004
            wait_for(lambda: plant.plant.now_s > gone_s)
            assert plant.plant.moving == PLANE.n, "4 ms are less than the watchdog"
            clock.now_s += 1.0
        memory = plant.buses.positioners.memory
        wait_for(lambda: not plant.plant.moving)
        assert set(memory["state"]) == {RobotState.FAULT}
        assert set(memory["fault"]) == {Fault.SILENCE}
        assert (memory["halted_s"] < gone_s + 0.006).all()
        assert (memory["position"][:, 0] != end[:, 0]).all()


@pytest.mark.parametrize("scale", [0.0, 0.5])
def test_robots_stop_when_a_connected_bridge_is_silent_for_longer_than_the_patience(path, scale):
    clock = FakeTime()
    with served(path, clock=clock, time_scale=scale, patience_s=2.0) as plant:
        session = moving(plant, ticks=1000)
        silent_s = plant.plant.now_s
        clock.now_s += 1.9
        with PlantTruth(path) as truth:
            truth.since()  # the plant has looked at its clock
            assert plant.plant.now_s == silent_s and plant.plant.moving == PLANE.n
            clock.now_s += 0.6
            wait_for(lambda: not plant.plant.moving)
        assert plant.plant.now_s >= silent_s + (2.5 * scale if scale else 0.0)
        # the bridge that wakes up finds its robots stopped, and starts them again
        finish(session, silent_s)
        assert set(session.result.outcome) == {Outcome.REACHED}
        assert len(session.loaded_plans) == 2


def test_orders_that_wait_lapse_when_the_bridge_is_gone(path):
    with served(path, time_scale=0.0) as plant:
        session, _ = session_on(plant.connect(), certify=end)
        t = session.configure(0.0)
        session.submit(turning(session))
        with pytest.raises(KeyboardInterrupt):
            session.start(t)
        assert plant.plant.waiting == PLANE.n
        session.transactions.backend.buses.close()
        wait_for(lambda: not plant.plant.connected and not plant.plant.waiting)
        memory = plant.buses.positioners.memory
        assert set(memory["fault"]) == {Fault.WATCHDOG}


def test_the_next_bridge_finds_robots_where_they_are_with_their_numbers(path):
    with served(path, time_scale=0.0) as plant:
        session = moving(plant, ticks=1000)
        session.transactions.backend.buses.close()
        wait_for(lambda: not plant.plant.connected and not plant.plant.moving)
        memory = plant.buses.positioners.memory.copy()
        later, _ = session_on(plant.connect())
        t = later.configure(0.0)
        assert t > plant.plant.truth.since()[2].ended_s.max()
        assert np.array_equal(later.counts, memory["position"])
        assert (later.counts != UNITS.to_counts(START)).any(axis=1).all()
        assert np.array_equal(later.robots["boot"], memory["boot"])
        # their watchdogs stopped them, so no operator has to clear
        assert set(memory["fault"]) == {Fault.SILENCE} and later.state is SessionState.IDLE
        finish(later, begin(later, t))
        assert set(later.result.outcome) == {Outcome.REACHED}


def test_a_second_bridge_is_refused_by_name_and_may_come_when_the_first_has_left(path):
    with served(path) as plant:
        first = plant.connect()
        with pytest.raises(PlantError, match=f"in use by a bridge, process {os.getpid()}"):
            plant.connect(pause=lambda _: None)
        assert first.alert_lines(0.0).size == 0
        first.close()
        assert plant.connect().alert_lines(0.0).size == 0


def test_a_bridge_with_another_plane_or_clock_is_refused_with_the_value(path):
    to = addresses_of(PLANE)
    moved = Addresses(to.bus, np.where(np.arange(PLANE.n) == 4, 999, to.address), to.ten_bit)
    with served(path) as plant:
        for ids, there, clock, match in (
            (PLANE.ids[:5], to[:5], "1M", "bridge has 5 robots, this plant 19"),
            (PLANE.ids, moved, "1M", f"robot {PLANE.ids[4]} has address {to.address[4]}.* 999"),
            (PLANE.ids, to, "400k", "1e.06 Hz in this plant, 400000 Hz"),
        ):
            with pytest.raises(PlantError, match=match):
                PlantBuses(path, ids, there, bus_timing(clock))
        assert not plant.plant.connected


def test_without_a_plant_no_robot_answers_and_the_next_plant_is_found(path):
    clock = FakeTime()
    with served(path) as plant:
        buses = plant.connect(answer_s=2.0, clock=clock)
        session, _ = session_on(buses)
        t = session.configure(0.0)
        assert session.known.all()
    t = session.configure(t)
    assert not session.known.any()
    with served(path):
        t = session.configure(t)
        assert not session.known.any(), "the bridge looks for a plant twice a second"
        clock.now_s += 0.5
        session.configure(t)
        assert session.known.all()


def test_a_paused_plant_keeps_the_bridge_no_longer_than_two_answers(path):
    with served(path) as plant:
        session, tap = session_on(plant.connect(answer_s=0.2, clock=FakeTime()))
        plant._ended.set()
        plant._thread.join(LONG_S)
        begin_s = time.monotonic()
        session.configure(0.0)
        assert len(tap.exchanges) >= 3 and not session.known.any()
        assert time.monotonic() < begin_s + 1.5


def test_a_request_that_its_bridge_left_behind_is_not_carried_out(path):
    with served(path) as plant:
        buses = plant.connect()
        plant._ended.set()
        plant._thread.join(LONG_S)  # the plant is paused
        state = plant.buses.positioners.memory.copy()
        to = addresses_of(PLANE)
        stop = pack(
            REQUESTS, Kind.TRANSFER, bus=to.bus, address=to.address, ten_bit=to.ten_bit,
            offsets=np.arange(PLANE.n + 1), data=np.full(PLANE.n, 0x30), read_bytes=0,
            not_before_s=0.0,
        )  # fmt: skip
        buses._link._socket.sendall(stop)
        buses.close()
        while plant.plant.connected:
            plant.server.step(0.1)
        assert np.array_equal(plant.buses.positioners.memory, state)
