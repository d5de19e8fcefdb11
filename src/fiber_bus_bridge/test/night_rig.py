# SPDX-License-Identifier: Apache-2.0
"""A bridge that is ended and begun anew beside robots that outlive it."""

from rest_of_graph import Rest, problem_file

import fiber_bus_bridge.node.hardware
from fiber_msgs_py import diagnostics, topics
from fiber_node import RosClient


class Night(Rest):
    """A bridge that can be ended at any moment; its robots are those of the bridge before."""

    def __init__(self, peer, problem, made, **parameters):
        self.given = dict(problem=problem, time_scale=0.2, attempts=1, **parameters)
        super().__init__(peer, problem, time_scale=0.2, attempts=1, **parameters)
        self.robots = made[0].positioners

    def restart(self):
        for stage in self.stages.values():
            self.peer.node.destroy_subscription(stage._subscription)
        self.peer.remove_node(self.bridge)
        given = dict(self.given)
        for messages in self.received.values():
            messages.clear()
        super().__init__(self.peer, given.pop("problem"), **given)

    def jam(self, robot):
        """Jam a robot that moves."""
        memory, bus = self.robots.memory, self.bridge._session.transactions
        self.until(lambda: bus.now_s > memory["started_s"][robot])
        memory["jam_s"][robot] = bus.now_s

    def left_out(self):
        statuses = diagnostics.decode(self.received[topics.DIAGNOSTICS.name][-1])
        return next((s.values for s in statuses if s.name == "bridge: left out"), {})


def make_night(tmp_path, monkeypatch):
    """Yield a night; the file of its memory is its `path`."""
    made, build = [], fiber_bus_bridge.node.hardware.simulated_buses
    monkeypatch.setattr(
        fiber_bus_bridge.node.hardware,
        "simulated_buses",
        lambda *given: made[0] if made else made.append(build(*given)) or made[0],
    )
    path = tmp_path / "robots.json"
    with RosClient("rest") as peer:
        made_night = Night(peer, problem_file(tmp_path), made, memory=str(path))
        made_night.path = path
        yield made_night
