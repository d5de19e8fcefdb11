# SPDX-License-Identifier: Apache-2.0
"""A trajectory that no order can express is refused, and so are absurd options, at once."""

import subprocess
import sys
from dataclasses import fields

import numpy as np
import pytest

from fiber_core.clearance import Safety
from fiber_core.errors import FiberError, MotionError
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireUnits
from fiber_discretizer import DiscretizeOptions, discretize
from fiber_discretizer.quantize import Rounding

EXTREMES = (0.0, -1.0, np.nan, np.inf, 1e-300, 1e12, 1e25, 2.0**63, "many")
PAPER = DiscretizeOptions(sharing="makarem2014")
BOTH = pytest.mark.parametrize("options", [DiscretizeOptions(), PAPER], ids=lambda o: o.sharing)
UNITS = WireUnits()


def moved(plane, lasts_s, rows=(0,), samples=2):
    # some robots turn by 0.5 rad in the given time
    angles = np.full((plane.n, 2, samples), 1.0)
    angles[list(rows)] += np.linspace(0.0, 0.5, samples)
    return SampledMotion(np.linspace(0.0, lasts_s, samples), angles)


@BOTH
@pytest.mark.parametrize("lasts_s", [1e3, 1e9, 1e25, 1e300])
def test_a_trajectory_longer_than_any_order_is_refused_robot_by_robot(plane_at, options, lasts_s):
    plane = plane_at([[0.0, 0.0], [30.0, 0.0]])
    done = discretize(plane, moved(plane, lasts_s), UNITS, Safety(), options=options)
    assert done.reason.tolist() == [Reason.BAD_TRAJECTORY, Reason.OK]
    assert len(done.wire.ticks) == 0


@BOTH
def test_a_robot_that_takes_too_long_does_not_hold_the_others(plane_at, options):
    plane = plane_at([[0.0, 0.0], [30.0, 0.0]])
    angles = np.full((2, 2, 3), 1.0)
    angles[0, :, 2] = 1.5
    angles[1, :, 1:] = 1.5
    trajectory = SampledMotion([0.0, 1.0, 1e9], angles)
    done = discretize(plane, trajectory, UNITS, Safety(), options=options)
    assert done.reason.tolist() == [Reason.BAD_TRAJECTORY, Reason.OK]
    assert done.wire.decoded().makespan_s < 1.2
    np.testing.assert_allclose(done.wire.decoded().end[1], 1.5, atol=1e-3)


@BOTH
def test_a_trajectory_as_long_as_an_order_is_discretized(plane_at, options):
    plane = plane_at([[0.0, 0.0]])
    lasts_s = 0.98 * UNITS.longest_order_s
    done = discretize(plane, moved(plane, lasts_s), UNITS, Safety(), options=options)
    assert done.reason.tolist() == [Reason.OK]


@BOTH
def test_rest_at_the_end_does_not_make_a_trajectory_too_long(plane_at, options):
    plane = plane_at([[0.0, 0.0]])
    angles = np.array([[[1.0, 1.5, 1.5], [1.0, 1.5, 1.5]]])
    done = discretize(
        plane, SampledMotion([0.0, 1.0, 1e9], angles), UNITS, Safety(), options=options
    )
    assert done.reason.tolist() == [Reason.OK]
    assert done.wire.decoded().makespan_s < 1.2


@pytest.mark.parametrize("robots, samples", [(1, 100_001), (1100, 100_000)])
def test_a_trajectory_with_too_many_samples_is_refused_whole(robots, samples):
    class Huge:  # of these sizes, without the memory
        n = robots
        time_s = range(samples)

    from fiber_discretizer.validate import check_size

    with pytest.raises(MotionError, match=f"{samples} samples of {robots} robots, expected at"):
        check_size(Huge())


@BOTH
@pytest.mark.parametrize("joint", [0, 1])
def test_a_fixed_joint_rests_while_the_other_moves(plane_at, options, joint):
    limits = np.array([[[-5.0, 5.0], [0.0, np.pi]]])
    limits[0, joint] = 1.2345678
    plane = plane_at([[0.0, 0.0]], limits=limits)
    seen = UNITS.to_angles(UNITS.encoder_counts(plane, np.full((1, 2), 1.2345678)))
    angles = np.repeat(seen[:, :, None], 3, axis=2)
    angles[0, 1 - joint] += [0.0, 0.3, 0.6]
    done = discretize(
        plane, SampledMotion([0.0, 0.5, 1.0], angles), UNITS, Safety(), options=options
    )
    assert done.reason.tolist() == [Reason.OK] and done.certificate.ok
    end = done.wire.decoded().end[0]
    assert end[joint] == seen[0, joint]
    assert abs(end[1 - joint] - seen[0, 1 - joint] - 0.6) < 1e-4


@pytest.mark.parametrize("config", [DiscretizeOptions, Rounding])
@pytest.mark.parametrize("extreme", EXTREMES, ids=str)
def test_an_extreme_option_is_refused_by_name_or_works(plane_at, config, extreme):
    plane = plane_at([[0.0, 0.0], [9.0, 0.0]])
    for field in fields(config):
        if field.name == "rounding":
            continue
        try:
            options = config(**{field.name: extreme})
        except FiberError as error:
            assert field.name in str(error)
            continue
        if config is Rounding:
            options = DiscretizeOptions(rounding=options)
        done = discretize(plane, moved(plane, 1.0, (0, 1)), UNITS, Safety(), options=options)
        assert len(done.reason) == 2


_DRAWN = """
import sys
import numpy as np
from fiber_core import FiberError, SampledMotion, WireUnits, preset
from fiber_core.clearance import Safety
from fiber_discretizer import DiscretizeOptions, discretize

rng = np.random.default_rng(int(sys.argv[1]))
plane = preset("desi", 3)
values = [0.0, -1.0, np.nan, np.inf, 1e-300, 1e12, 1e25, 2.0**63, 1e9, 1e300]
for draw in range(60):
    time_s, angles = np.linspace(0.0, 1.0, 5), np.ones((3, 2, 5)) + np.linspace(0, 0.2, 5)
    velocities = np.zeros_like(angles)
    counts = None
    for array in (time_s, angles, velocities):
        for _ in range(rng.integers(3)):
            array[tuple(rng.integers(array.shape))] = rng.choice(values)
    if rng.random() < 0.5:
        time_s = np.sort(time_s)
    if rng.random() < 0.3:
        counts = np.full((3, 2), rng.choice([-(2**62), 0, 2**31, 2**62, 600_000]))
    options = DiscretizeOptions(sharing=["sequential", "makarem2014"][draw % 2])
    try:
        discretize(plane, SampledMotion(time_s, angles), WireUnits(), Safety(), counts, options,
                   velocities=velocities)
    except FiberError:
        pass
print("done")
"""


@pytest.mark.parametrize("seed", [0, 1])
def test_no_drawn_trajectory_crashes_or_hangs(seed):
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", _DRAWN, str(seed)],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert run.stdout == "done\n", run.stderr[-2000:]
