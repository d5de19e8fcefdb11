# SPDX-License-Identifier: Apache-2.0
"""Control software for the ROS graph: send targets, follow, start, disable a robot, stop in motion.

The client uses the stock messages of the graph and nothing else. Start a graph first, with
`ros2 launch fiber_bringup focal_plane.launch.py preset:=desi robots:=61`, then run
`python3 examples/control_script.py`.
"""

import sys

import numpy as np

from fiber_client import DisabledRobots, PlaneClient
from fiber_core.errors import FiberError
from fiber_core.fields import random_problem
from fiber_core.outcomes import Outcome, Reason
from fiber_msgs_py import Progress, topics

TIMEOUT_S = 120.0


def show(progress: Progress) -> None:
    """Print the progress of a stage."""
    print(f"  {progress.stage}: {100 * progress.fraction:3.0f} %  {progress.text}")


def targets_from_here(client: PlaneClient, seed: int):
    """Return the ids of all enabled robots and random targets for them [mm]."""
    plane = client.plane
    problem = random_problem(plane, np.random.default_rng(seed), start=client.angles)
    return plane.ids[problem.asked], problem.targets[problem.asked]


def print_outcome(outcome) -> None:
    """Print how many robots ended in which way, and the reasons of those that are held."""
    for kind in Outcome:
        print(f"  {kind.name.lower()}: {outcome.count(kind)}")
    for reason, count in zip(*np.unique(outcome.reason, return_counts=True)):
        print(f"    {Reason(reason).name.lower()}: {count}")


def reconfigure(client: PlaneClient, seed: int) -> None:
    """Carry out one plan in four steps."""
    stamp = client.send_targets(*targets_from_here(client, seed))
    client.wait_until_ready(stamp, TIMEOUT_S)
    print(client.start(TIMEOUT_S))
    print_outcome(client.wait_for_outcome(stamp, TIMEOUT_S))


def stop_in_motion(client: PlaneClient, seed: int) -> None:
    """Start a plan, stop all robots as soon as they move, and clear the stop."""
    stamp = client.send_targets(*targets_from_here(client, seed))
    client.wait_until_ready(stamp, TIMEOUT_S)
    client.start(TIMEOUT_S)
    print(client.call_service(topics.STOP, TIMEOUT_S))
    print_outcome(client.wait_for_outcome(stamp, TIMEOUT_S))
    client.call_service(topics.CLEAR, TIMEOUT_S)


def main() -> int:
    """Run the script; returns the exit code."""
    with PlaneClient(on_progress=show) as client:
        try:
            client.wait_for_graph(TIMEOUT_S)
            print(f"{client.plane.n} robots, {client.plane.enabled.sum()} can be commanded")
            print("one reconfiguration")
            reconfigure(client, seed=1)

            robot = int(client.plane.ids[0])
            print(f"robot {robot} is taken out of use: it stays where it is, others avoid it")
            disabled = DisabledRobots(client, TIMEOUT_S)
            before = disabled.read()
            disabled.write([*before, robot], why="shown in an example")
            client.wait_for(lambda: not client.plane.enabled[0], TIMEOUT_S, "the new layout")
            reconfigure(client, seed=2)

            print("a stop in motion")
            stop_in_motion(client, seed=3)
            disabled.write(before)
        except FiberError as error:
            print(f"control_script: {error}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
