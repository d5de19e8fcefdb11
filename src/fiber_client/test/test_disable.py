# SPDX-License-Identifier: Apache-2.0
"""What the diagnostics of the bridge say about robots that are left out, as commands read it."""

from fiber_client.disable import DisabledRobots
from fiber_client.vouch import unknown_places
from fiber_msgs_py import Level, Status

VALUES = {
    "robot 3": "arm bent",
    "robot 4": "place unknown (no_reply): its neighbours rest",
    "further no_reply": "7 8",
    "further place unknown": "9 12",
}


class Client:
    """A client that receives the diagnostics once it waits; it models nothing else."""

    def __init__(self):
        self.statuses = {}

    def wait_for(self, condition, timeout_s, what):
        name = "bridge: left out"
        self.statuses[name] = Status(name, Level.WARN, "", VALUES)
        assert condition()


def test_robots_without_a_line_of_their_own_are_read_too():
    reasons = DisabledRobots(Client(), 1.0).reasons()
    assert reasons[3] == "arm bent" and reasons[7] == reasons[8] == "no_reply"
    assert unknown_places(Client(), 1.0) == [4, 9, 12]
