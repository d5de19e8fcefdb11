# SPDX-License-Identifier: Apache-2.0
"""The closed loop: a camera finds what counters do not know, and a correction repairs it."""

import numpy as np
import pytest

from fiber_bus_bridge.simulation import NEVER, MechanicalErrors, Mechanics, draw_mechanics
from fiber_core import kinematics
from fiber_core.fields import random_field
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.problem import Problem
from fiber_metrology import ImageError, MetrologyError, Verdict
from fiber_metrology.camera import CameraConfig, SimulatedCamera, fiducial_places
from fiber_planner import StraightPlanner
from fiber_positioners import LoopConfig, closed_loop

N = 61
DRIVE = MechanicalErrors(scale=0.005, backlash_deg=0.1, wave_deg=0.1)


class Rig:
    def __init__(self, seed=1, camera=None):
        self.plane = preset("desi", N)
        rng = np.random.default_rng(seed)
        self.problem = random_field(self.plane, rng, 0.5).problem
        self.mechanics = draw_mechanics(N, DRIVE, rng)
        self.fiducials = fiducial_places(self.plane, 30)
        quiet = CameraConfig(missing=0.0, merged=0.0)
        self.camera = SimulatedCamera(60.0, camera or quiet, rng)

    def loop(self, lit=None, **settings):
        lit = np.ones(N, dtype=bool) if lit is None else lit
        return closed_loop(
            self.problem, self.mechanics, self.camera, self.fiducials, lit, **settings
        )


def rms_um(errors):
    return 1e3 * np.sqrt(np.nanmean(errors**2))


def test_a_correction_brings_fibres_to_their_targets_that_counters_call_reached():
    loop = Rig().loop()
    assert (loop.moves[0].run.result.error_mm < 0.01).all()  # by the counters
    assert rms_um(loop.errors_mm(0)) > 25.0
    assert rms_um(loop.errors_mm(1)) < 10.0
    for move in loop.moves:
        assert move.measurement.certain.all() and not move.run.certificate.unsafe.any()
        assert not move.touches.unsafe.any()
        assert (
            np.abs(move.measurement.angles - move.angles) <= move.measurement.interval_rad
        ).all()


def test_a_silent_non_mover_is_named_and_rests_while_the_others_are_corrected():
    rig = Rig(seed=2)
    still = np.full((N, 2), NEVER)
    still[[5, 11]] = 0
    rig.mechanics = rig.mechanics.with_(still_in=still)
    loop = rig.loop()
    assert np.flatnonzero(loop.not_moved).tolist() == [5, 11]
    assert loop.moves[0].run.result.error_mm[5] < 0.01  # the robot reports that it arrived
    np.testing.assert_array_equal(loop.moves[1].angles[[5, 11]], loop.moves[0].angles[[5, 11]])
    others = np.delete(np.arange(N), [5, 11])
    assert rms_um(loop.errors_mm(1)[others]) < 10.0


def test_arms_without_errors_are_where_the_camera_finds_them_and_stay():
    rig = Rig(seed=3)
    rig.mechanics = Mechanics.ideal(N)
    loop = rig.loop(corrections=0)
    assert len(loop.moves) == 1 and rms_um(loop.errors_mm(0)) < 1.0
    assert (loop.moves[0].measurement.verdict == Verdict.MEASURED).all()


def test_the_same_seed_closes_the_loop_in_the_same_way():
    one, two = (Rig(seed=4).loop(seed=9) for _ in range(2))
    assert one.moves[1].angles.tobytes() == two.moves[1].angles.tobytes()


def test_an_image_that_cannot_be_used_ends_the_loop_and_bad_settings_are_refused():
    rig = Rig(seed=5, camera=CameraConfig(shift_mm=30.0))
    with pytest.raises(ImageError, match="shifted"):
        rig.loop()
    with pytest.raises(MetrologyError, match="exposures"):
        LoopConfig(exposures=0)


def test_a_correction_goes_straight_and_flips_no_elbow_however_near_the_other_one_is():
    plane = preset("moons", 3)  # phi turns both ways
    start = np.array([[0.3, 0.02], [0.3, 1.0], [0.3, -1.0]])
    targets = kinematics.forward(plane, start + [0.01, 0.05])[1]
    planned = StraightPlanner().plan(Problem(plane, start, targets))
    np.testing.assert_allclose(planned.goal, start + [0.01, 0.05], atol=1e-6)
    assert set(planned.reason) == {Reason.OK} and planned.motion.angles.shape == (3, 2, 2)
    short = StraightPlanner(most_rad=0.04).plan(Problem(plane, start, targets))
    assert set(short.reason) == {Reason.GOAL_BLOCKED}
    np.testing.assert_array_equal(short.motion.end, start)
    none = np.full((3, 2), np.nan)
    assert set(StraightPlanner().plan(Problem(plane, start, none)).reason) == {Reason.NO_TARGET}
