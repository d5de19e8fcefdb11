# SPDX-License-Identifier: Apache-2.0
"""Sessions that believe no counters, for tests of robots at unknown places."""

import numpy as np
from session_rig import Rig

from fiber_bus_bridge import SessionConfig
from fiber_bus_bridge.measured_places import learn_intervals, place_robots
from fiber_bus_bridge.robot_memory import load_memory, save_memory
from fiber_core.clearance import Safety

CONFIG = SessionConfig(counters_kept=False)
HALF_MM = 0.5 * Safety().margin_mm
N = 19
ALL = np.ones(N, dtype=bool)


def new_rig(before=None, memory=None, **rig):
    """A session that begins; the robots are those of an earlier one."""
    rig = Rig(N, config=CONFIG, robots=before and before.robots, volatile=True, **rig)
    rig.t = before.t if before else 0.0
    if memory is not None:
        rig.session.recall(memory)
    rig.call("configure")
    return rig


def cut_power(rig, rows):
    rig.robots.power(np.asarray(rows), False, rig.t)
    rig.robots.power(np.asarray(rows), True, rig.t)
    rig.t += 0.1
    rig.call("configure")


def place(rig, counts, chosen, turn_known=True):
    """Tell robots where a camera has seen them, without an error."""
    place_robots(rig.session, counts, chosen, rig.t, turn_known)
    learn_intervals(rig.session, 0.0, 0.0)


def remembered(rig, path, starting=False):
    """The memory of a session, by way of its file."""
    memory = rig.session.memory(np.zeros(N, dtype=np.int64), starting)
    save_memory(path, memory, rig.plane, rig.units.quantum_prad)
    return load_memory(path, rig.plane, rig.units.quantum_prad, len(rig.session.buses))
