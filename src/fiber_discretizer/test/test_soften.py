# SPDX-License-Identifier: Apache-2.0
"""Large changes of velocity in two steps, and orders for planes with a ramp."""

import numpy as np
import pytest

from fiber_core.clearance import Safety
from fiber_core.drive import Drive, carried_out
from fiber_core.drive.named import with_drive
from fiber_core.fields import random_problem
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.presets import preset
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer import discretize
from fiber_discretizer.soften import softened

_UNITS = WireUnits()
_RAMP = 20  # ticks


def _drive(largest: float) -> Drive:
    ramp_s = _RAMP * _UNITS.tick_s
    return Drive(1, ramp_s, largest * _UNITS.velocity_rad_s / ramp_s)


def _theta(ticks, velocity) -> WireMotion:
    offsets = np.array([0, len(ticks), len(ticks)])
    return WireMotion(_UNITS, np.zeros((1, 2), int), offsets, np.array(ticks), np.array(velocity))


@pytest.mark.parametrize("seed", range(20))
def test_a_reversal_is_made_in_two_steps_that_the_motor_can_make(seed):
    rng = np.random.default_rng(seed)
    velocity = rng.integers(2500, 4000, 2) * [1, -1]
    motion = _theta([100, 120], velocity)
    drive = _drive(4001.0)
    assert carried_out(drive, motion.decoded()).hardest[0, 0] > drive.acceleration_rad_s2[0, 0]
    soft = softened(drive, motion)
    hardest = carried_out(drive, soft.decoded()).hardest
    assert (hardest <= drive.acceleration_rad_s2 * (1 + 1e-9)).all()
    assert soft.counts.tolist() == [[3, 0]] and soft.ticks.sum() == 220
    assert np.abs(soft.end - motion.end).max() <= 2
    assert softened(drive, soft).velocity.tolist() == soft.velocity.tolist()


def test_small_changes_and_segments_without_space_stay_as_they_are():
    for motion in (_theta([100, 120], [3000, -900]), _theta([5, 5], [3000, -3000])):
        soft = softened(_drive(4001.0), motion)
        assert soft.ticks.tolist() == motion.ticks.tolist()
        assert soft.velocity.tolist() == motion.velocity.tolist()


def test_every_robot_of_a_field_gets_orders_that_its_motors_can_carry_out():
    plane = with_drive(preset("desi", 60), "accelerated")
    problem = random_problem(plane, np.random.default_rng(3), gap_mm=1.0)
    goal = random_problem(plane, np.random.default_rng(4), gap_mm=1.0).start
    there = np.linspace(0.0, 1.0, 25)
    # half of the robots go to and fro, as fast as they can
    back = np.where(np.arange(60)[:, None, None] % 2, 2 * np.minimum(there, 1 - there), there)
    angles = problem.start[:, :, None] + (goal - problem.start)[:, :, None] * back
    lasts_s = 2.2 * (np.abs(goal - problem.start) / plane.speeds).max()
    done = discretize(
        plane, SampledMotion(lasts_s * there, angles), WireUnits.for_plane(plane), Safety()
    )
    assert done.certificate.ok
    curve = carried_out(plane.drive, done.wire.decoded())
    assert (curve.hardest <= plane.drive.acceleration_rad_s2 * (1 + 1e-9)).all()
    assert (done.reason == Reason.OK).sum() > 40
