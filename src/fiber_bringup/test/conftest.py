# SPDX-License-Identifier: Apache-2.0
"""Plans of a small plane with a recorder in the graph: done, home, replaced, stopped."""

import sys
from pathlib import Path

import numpy as np
import pytest

from fiber_bringup.graph import Graph
from fiber_client.client import PlaneClient
from fiber_core.fields import random_field
from fiber_msgs_py import PlanStamp, topics
from fiber_recording import load_recording
from fiber_recording.node import recording_name
from fiber_recording.settled_replay import settled_replay

sys.path.append(str(Path(__file__).parent))  # helper modules in this folder
COMPILE_S, WAIT_S, ROBOTS = 600.0, 60.0, 37


def recorded(client, folder, stamp):
    client.wait_for(lambda: "recorder" in client.times[stamp], WAIT_S, "the recording")
    return load_recording(folder / recording_name(stamp))


def new_targets(client, seed):
    rng = np.random.default_rng(seed)
    drawn = random_field(client.plane, rng, start=client.angles).problem
    return client.plane.ids[drawn.asked], drawn.targets[drawn.asked]


class Run:
    """The plans and their recordings."""

    def __init__(self, folder, domain):
        bridge = {"robots": ROBOTS, "time_scale": 0.0}
        recorder = {"folder": str(folder), "seed": 5, "planner": "direct", "preset": "desi"}
        with (
            Graph(bridge=bridge, recorder=recorder, domain=domain) as graph,
            PlaneClient(domain) as client,
        ):
            client.wait_for_graph(COMPILE_S, also=("recorder",))
            self.plane, self.before = client.plane, client.units.to_counts(client.angles)
            self.targets = new_targets(client, 1)
            self.ended = client.reconfigure(*self.targets, COMPILE_S)
            self.replayed = settled_replay(client, self.ended, self.before, WAIT_S)
            self.after = client.units.to_counts(client.angles)
            self.done = recorded(client, folder, PlanStamp(self.ended.stamp_ns))
            self.home = recorded(client, folder, PlanStamp(client.home(WAIT_S).stamp_ns))
            replaced = client.send_targets(*self.targets)
            client.wait_until_ready(replaced, WAIT_S)
            client.wait_until_ready(client.send_targets(*self.targets), WAIT_S)
            client.wait_for_outcome(replaced, WAIT_S)
            self.replaced = recorded(client, folder, replaced)
            assert graph.running
        with (
            Graph(bridge=bridge | {"time_scale": 0.2}, recorder=recorder, domain=domain),
            PlaneClient(domain) as client,
        ):
            client.wait_for_graph(COMPILE_S, also=("recorder",))
            stamp = client.send_targets(*new_targets(client, 2))
            client.wait_until_ready(stamp, WAIT_S)
            client.start(WAIT_S)
            client.wait_for(lambda: client.moving, WAIT_S, "motion")
            client.call_service(topics.STOP, WAIT_S)
            self.halted = client.wait_for_outcome(stamp, WAIT_S)
            self.stopped = recorded(client, folder, stamp)
            self.at_rest = client.units.to_counts(client.angles)


@pytest.fixture(scope="session")
def run(tmp_path_factory, new_domain):
    return Run(tmp_path_factory.mktemp("recordings"), new_domain())
