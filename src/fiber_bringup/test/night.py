# SPDX-License-Identifier: Apache-2.0
"""A graph with a simulated camera, for tests of the closed loop."""

import threading

import numpy as np

from fiber_bringup.graph import Graph
from fiber_bus_bridge.plant.plant import Plant
from fiber_bus_bridge.plant.server import PlantServer, listen
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses, simulated_problem
from fiber_client.client import PlaneClient
from fiber_client.closed_loop import CameraLoop
from fiber_core.fields import random_field
from fiber_core.wire_units import WireUnits

WAIT_S, COMPILE_S, ROBOTS = 60.0, 600.0, 61
ARMS = {"scale": 0.004, "backlash_deg": 0.08, "wave_deg": 0.12, "non_movers": 0.04}


class Night:
    """A plant, the graph with a camera, and a client."""

    def __init__(self, folder, domain, simulation=None, preset="desi", **bridge):
        self.domain, path = domain, folder / "plant"
        config = SimulationConfig(preset=preset, robots=ROBOTS, **(simulation or {}))
        problem = simulated_problem(config).problem
        units = WireUnits.for_plane(problem.plane)
        buses = simulated_buses(problem.plane, units, problem.start, config)
        self.plant = plant = Plant(buses, units.quantum_rad, 0.0)
        listener, self._lock = listen(path)
        self._server = PlantServer(plant, problem.plane.ids, listener, lambda: 0.0)
        self._ended = threading.Event()
        self._thread = threading.Thread(
            target=self._server.serve, args=[self._ended.is_set], daemon=True
        )
        self._thread.start()
        self.bridge = {"preset": preset, "robots": ROBOTS, "plant": str(path), "time_scale": 0.0,
                       "memory": "none", "blind_um": 40.0} | bridge  # fmt: skip
        camera = {"plant": str(path), "seed": 3, "dark": 0.04}
        camera |= {f"arms.{name}": value for name, value in ARMS.items()}
        self.recordings = folder / "recordings"
        self.graph = Graph(
            bridge=self.bridge, metrology={"timeout_s": COMPILE_S}, camera=camera, domain=domain,
            recorder={"folder": str(self.recordings)},
        )  # fmt: skip
        self.graph.__enter__()
        self.metrology, self.camera = self.graph.nodes[-2:]
        self.client = PlaneClient(domain, args=[])
        self.client.wait_for_graph(COMPILE_S)
        # its layout may come to the camera later than to the client
        self.client.wait_for(lambda: self.camera._plane is not None, WAIT_S)
        # true places are told once: a recorder that has not found the camera yet misses them
        self.client.wait_for(lambda: self.camera._true.get_subscription_count() > 0, WAIT_S)

    def end(self):
        self.client.close()
        self.graph.__exit__(None, None, None)
        self._ended.set()
        self._thread.join(WAIT_S)
        self._server.close(self._lock)

    def field(self, seed):
        rng = np.random.default_rng(seed)
        plane = self.client.plane
        drawn = random_field(plane, rng, 0.1, start=self.client.angles).problem
        return plane.ids[drawn.asked], drawn.targets[drawn.asked]

    def true_fibres(self):
        return self.camera._true_fibres(self.client.plane)

    def loop(self, tolerance_um=12.0, iterations=2):
        return CameraLoop(self.client, tolerance_um, iterations, COMPILE_S)
