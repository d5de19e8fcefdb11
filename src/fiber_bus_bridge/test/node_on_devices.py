# SPDX-License-Identifier: Apache-2.0
"""Tests of the bridge node in real time on mock devices, run by `test_node_devices.py`.

Not collected directly: they work only inside `umockdev-wrapper`.
"""

import time

import numpy as np
import pytest
from kernel_buses import Kernel
from rest_of_graph import COUNTS, PLANE, UNITS, Rest, problem_file, turning

from fiber_bus_bridge import addresses_of
from fiber_bus_bridge.simulation import Positioners, SimulatedBuses
from fiber_core.outcomes import Outcome, Reason
from fiber_core.wire_units import WireMotion
from fiber_msgs_py import joint_states, topics
from fiber_node import RosClient

# a message takes longer on a mock device than on a bus, and the machine is shared
PATIENT = {
    "session__silence_ms": 400,
    "session__heartbeat_period_s": 0.02,
    "session__stretch_s": float("inf"),
}


@pytest.fixture
def rest(tmp_path):
    """A bridge on a mock device with robots that are not at their assumed angles."""
    moved = COUNTS + [30, 0]
    robots = Positioners(addresses_of(PLANE), PLANE.ids, UNITS.quantum_prad, moved)
    kernel = Kernel(SimulatedBuses(robots), time.monotonic)
    with RosClient("rest") as peer:
        rest = Rest(peer, problem_file(tmp_path), devices=["/dev/i2c-0"], **PATIENT)
        rest.robots = robots
        yield rest
    kernel.close()


def orders(ticks):
    motion = turning(ticks=ticks)
    return WireMotion(UNITS, COUNTS + [30, 0], motion.offsets, motion.ticks, motion.velocity)


def test_a_plan_is_carried_out_in_real_time(rest):
    rest.until(lambda: np.array_equal(rest.counts(), COUNTS + [30, 0]))  # as the encoders read
    motion = orders(200)
    rest.ready(9, motion)
    begin = time.monotonic()
    answer = rest.call(topics.START)
    assert answer.success and "7 robots started" in answer.message
    result, reason, _ = rest.end(9)
    assert time.monotonic() - begin > motion.decoded().makespan_s
    assert set(result) == {Outcome.REACHED} and set(reason) == {Reason.OK}
    rest.until(lambda: np.array_equal(rest.counts(), motion.end))
    assert np.array_equal(rest.robots.memory["position"], motion.end)


def test_a_stop_is_carried_out_at_once(rest):
    motion = orders(1000)
    rest.ready(9, motion)
    assert rest.call(topics.START).success

    def moving():
        return joint_states.decode(rest.received[topics.JOINT_STATES.name][-1])[2].any()

    rest.until(moving)
    assert rest.call(topics.STOP).success
    rest.end(9)
    stopped = rest.robots.memory["position"]
    rest.until(lambda: np.array_equal(rest.counts(), stopped))
    gone = np.abs(stopped - motion.start)[:, 0] / np.abs(motion.end - motion.start)[:, 0]
    assert np.all(gone > 0) and np.all(gone < 0.9)
