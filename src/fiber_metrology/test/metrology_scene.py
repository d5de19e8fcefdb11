# SPDX-License-Identifier: Apache-2.0
"""A small plane with a camera, shared by the tests of this package."""

from dataclasses import replace

import numpy as np

from fiber_core import kinematics
from fiber_core.fields import random_field
from fiber_core.presets import preset
from fiber_metrology import Expected, measure
from fiber_metrology.camera import CameraConfig, SimulatedCamera, fiducial_places

N = 169
QUIET = CameraConfig(missing=0.0, merged=0.0, stray=0.0)


class Scene:
    """Robots that went from one field to another, and a camera that looks at them."""

    def __init__(self, seed=0, camera=QUIET, blind_um=40.0):
        self.plane = preset("desi", N)
        self.rng = np.random.default_rng(seed)
        field = random_field(self.plane, self.rng)
        self.before, self.counters = np.array(field.problem.start), np.array(field.goal)
        self.camera = SimulatedCamera(90.0, camera, self.rng)
        self.blind_um = blind_um
        tips = kinematics.forward(self.plane, self.counters)[1]
        off = self.rng.normal(size=(N, 2)) * blind_um * 1e-3
        angles, _ = kinematics.inverse(self.plane, tips + off)
        near = np.abs(angles - self.counters[:, None]).sum(axis=2)
        best = np.argmin(np.where(np.isnan(near), np.inf, near), axis=1)
        found = angles[np.arange(N), best]
        self.true = np.where(np.isnan(found), self.counters, found)
        # a fibre that is on a fiducial merges with it
        places = fiducial_places(self.plane, 50)
        apart = np.hypot(*(places[:, None] - self.tips[None]).transpose(2, 0, 1)).min(axis=1)
        self.fiducials = places[apart > 1.0][:40]

    @property
    def tips(self):
        return kinematics.forward(self.plane, self.true)[1]

    def away_mm(self):
        """How far each robot should have moved."""
        ends = [kinematics.forward(self.plane, a)[1] for a in (self.before, self.counters)]
        return np.hypot(*(ends[1] - ends[0]).T)

    def expose(self, lit=None, exposures=2, **changes):
        if changes:
            self.camera.config = replace(self.camera.config, **changes)
        lit = np.ones(N, dtype=bool) if lit is None else lit
        return [
            self.camera.expose(self.tips, self.fiducials, lit, self.rng) for _ in range(exposures)
        ]

    def expected(self, **changes):
        known = np.full((N, 2), 1e-3)
        made = Expected(self.plane, self.counters, self.before, known, self.blind_um)
        return replace(made, **changes)

    def measure(self, exposures, **changes):
        spots = [exposure.spots for exposure in exposures]
        return measure(self.expected(**changes), spots, self.fiducials, self.camera.calibrated)


def owners(image, exposures):
    """The robot whose light each robot was told to have, -9 for none."""
    rows = np.flatnonzero(image.certain)
    found = np.full(image.plane.n, -9)
    first = image.lights.first[image.light[rows]]
    found[rows] = [exposures[k].owner[spot] for spot, k in first]
    return found
