# SPDX-License-Identifier: Apache-2.0
"""Run a small plane through the installed nodes, so that every loop is compiled and cached.

It runs the nodes themselves, because a loop is compiled for the types of its arrays, and an array
that is read-only, or came in a message, has a type of its own.
"""

import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from tempfile import TemporaryDirectory

import numpy as np

from fiber_bringup.graph import Graph
from fiber_bus_bridge.plant.rehearsal import rehearse
from fiber_client.client import PlaneClient
from fiber_core.drive.named import with_drive
from fiber_core.fields import random_field, random_problem
from fiber_core.presets import preset
from fiber_msgs_py import PlanStamp
from fiber_node.ros_environment import own_domain
from fiber_planner import LISTED_PLANNER, make_planner, planners

_WAIT_S = 600.0


def _reconfigure(planner: str) -> None:
    domain = own_domain()
    bridge = {"preset": "desi_outlines", "robots": 37, "time_scale": 0.0}
    with (
        TemporaryDirectory() as folder,
        Graph(
            planner={"planner": planner},
            bridge=bridge,
            recorder={"folder": folder},  # subscribes to corridors, and replays the frames
            domain=domain,
            args=["--ros-args", "--log-level", "warn"],
        ),
        PlaneClient(domain) as client,
    ):
        client.wait_for_graph(_WAIT_S, also=("recorder",))
        rng = np.random.default_rng(0)
        problem = random_field(client.plane, rng, start=client.angles).problem
        ended = client.reconfigure(client.plane.ids, problem.targets, _WAIT_S)
        client.wait_for_recording(PlanStamp(ended.stamp_ns), _WAIT_S)


def _plan(name: str) -> None:
    # arms in each other's way, and robots that never move; with this seed every loop is used
    plane = preset("moons", 61).with_enabled(np.arange(61) % 7 > 0)
    if name == LISTED_PLANNER:
        plane = with_drive(preset("desi_petals", 61), "desi", motors_on=0.55)
    make_planner(name).plan(random_problem(plane, np.random.default_rng(4)))


def main() -> int:
    """Compile the loops of all planners and of the whole chain on two cores."""
    with ProcessPoolExecutor(2) as pool:
        done = [pool.submit(_reconfigure, "dnf")]
        done += [pool.submit(_plan, name) for name in planners() if name != "dnf"]
        done.append(pool.submit(rehearse))
        for count, each in enumerate(as_completed(done), 1):
            each.result()
            print(f"compiled {count} of {len(done)} parts", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
