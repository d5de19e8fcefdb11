# SPDX-License-Identifier: Apache-2.0
"""Measured robots: places, angles, and a verdict with the reason on every other one."""

import numpy as np
import pytest
from metrology_scene import N, Scene, owners

from fiber_core import kinematics
from fiber_core.fields import random_field
from fiber_core.outcomes import STILL
from fiber_core.presets import preset
from fiber_metrology import (
    DriveErrors,
    IdentifyConfig,
    ImageError,
    Knowledge,
    MeasureConfig,
    MetrologyError,
    Verdict,
    follows,
    measure,
)
from fiber_metrology.camera import CameraConfig
from fiber_metrology.reasons import reason_text


def test_every_fibre_is_found_to_a_few_micrometres_and_every_interval_holds(scene):
    exposures = scene.expose()
    image = scene.measure(exposures)
    assert image.certain.all() and (image.verdict == Verdict.MEASURED).all()
    np.testing.assert_array_equal(owners(image, exposures), np.arange(N))
    off = np.hypot(*(image.places - scene.tips).T)
    assert np.sqrt(np.mean(off**2)) < 6e-3 and (off < image.error_mm).all()
    assert (np.abs(image.angles - scene.true) <= image.interval_rad).all()
    assert follows(image).all() and image.reasons() == []


@pytest.mark.parametrize("seed", range(4))
def test_nothing_wrong_is_told_as_certain_with_everything_that_goes_wrong(seed):
    scene = Scene(seed, CameraConfig(missing=0.1, merged=0.05, stray=0.1))
    lit = scene.rng.random(N) > 0.05
    exposures = scene.expose(lit)
    image = scene.measure(exposures)
    told = owners(image, exposures)
    certain = image.certain
    np.testing.assert_array_equal(told[certain], np.flatnonzero(certain))
    assert certain.sum() > 0.9 * lit.sum() and not certain[~lit].any()
    off = np.hypot(*(image.places - scene.tips).T)
    assert np.nanmax(off) < 0.03
    assert not image.not_moved.any()
    dark = scene.measure(exposures, dark=~lit).verdict[~lit]
    # a stray light in reach may be its light
    assert set(dark) <= {Verdict.DARK, Verdict.AMBIGUOUS, Verdict.UNEXPLAINED}
    assert Verdict.DARK in dark


def test_a_joint_that_did_not_turn_is_named_and_no_other(scene):
    still = np.zeros((N, 2), dtype=bool)
    still[:9] = [[1, 1]] * 3 + [[1, 0]] * 3 + [[0, 1]] * 3
    moved = np.where(still, scene.before, scene.counters)
    ends = [kinematics.forward(scene.plane, a)[1] for a in (moved, scene.counters)]
    away = np.hypot(*(ends[1] - ends[0]).T)
    assert (away[:9] > 0.5).all()
    scene.true = np.where(still, scene.before, scene.true)
    image = scene.measure(scene.expose())
    wanted = [Verdict.NOT_MOVED, Verdict.THETA_NOT_MOVED, Verdict.PHI_NOT_MOVED]
    assert image.verdict[:9].tolist() == np.repeat(wanted, 3).tolist()
    assert (image.verdict[9:] == Verdict.MEASURED).all()
    assert (np.abs(image.angles - scene.true) <= image.interval_rad)[:9].all()
    assert not follows(image)[:9].any()
    assert image.reasons()[3] == (
        f"robot {scene.plane.ids[3]}: theta not moved: theta did not turn when it was told to; "
        f"{image.off_mm[3]:.3f} mm from where its counters say"
    )
    assert (np.abs(image.off_mm - away)[:9] < 0.3).all() and (image.off_mm[9:] < 0.3).all()


@pytest.mark.parametrize("verdict", [code for code in Verdict if code != Verdict.MEASURED])
def test_every_verdict_but_measured_has_its_reason_in_words(verdict):
    text = reason_text(verdict, np.nan, 0.02, [3, 5])
    name, why = text.split(": ")
    assert name == verdict.name.lower().replace("_", " ") and len(why.split()) > 4
    assert ("doubt 2.0e-02, shares lights with 3, 5" in text) == (verdict == Verdict.AMBIGUOUS)
    assert "from where its counters say" not in text
    assert reason_text(verdict, 0.41, 0.0).endswith("; 0.410 mm from where its counters say")


def test_a_joint_is_named_with_a_doubt_at_which_its_place_is_not_told(scene):
    scene.true[:3] = scene.before[:3]
    strict = MeasureConfig(found=0.0, identify=IdentifyConfig(certain=1e-12))
    spots = [exposure.spots for exposure in scene.expose()]
    image = measure(scene.expected(), spots, scene.fiducials, scene.camera.calibrated, strict)
    assert (image.verdict[:3] == Verdict.NOT_MOVED).all() and not image.certain[:3].any()
    assert not image.not_moved[3:].any() and not follows(image)[:3].any()


def test_a_robot_off_its_model_is_measured_and_named(scene):
    scene.true[4, 0] += np.deg2rad(4.0) * np.sign(0.5 - (scene.true[4, 0] > 0))
    image = scene.measure(scene.expose())
    assert image.verdict[4] in (Verdict.OFF_MODEL, Verdict.AMBIGUOUS, Verdict.UNEXPLAINED)
    assert (np.delete(image.verdict, 4) == Verdict.MEASURED).all()


def test_a_lit_fibre_where_no_robot_should_be_is_never_told_as_dark(scene):
    # joints that slipped: neither where they were told to be, nor where they had been
    slipped, dark = np.array([3, 40, 90]), np.array([8, 120, 150])
    scene.true[slipped] = (0.5 * (scene.before + scene.counters))[slipped]
    lit = ~np.isin(np.arange(N), dark)
    known = Knowledge(scene.plane, half_rad=np.full((N, 2), 1e-3))
    known.begin(scene.before, False)
    for told in (Verdict.MISSING, Verdict.DARK):
        spots = [exposure.spots for exposure in scene.expose(lit)]
        expected = known.expected(scene.counters)
        image = measure(expected, spots, scene.fiducials, scene.camera.calibrated)
        assert not np.isin(image.verdict[slipped], (Verdict.MISSING, Verdict.DARK)).any()
        assert Verdict.UNEXPLAINED in image.verdict[slipped]
        # one that moved less is found next to where it would be with one joint that stuck
        found = slipped[image.certain[slipped]]
        off = np.hypot(*(image.places - scene.tips).T)
        assert (image.verdict[found] == Verdict.OFF_MODEL).all() and len(found) < len(slipped)
        assert (off < image.error_mm)[found].all() and not image.certain[dark].any()
        # beside a fibre that slipped nothing tells which of both is dark
        reach = scene.plane.arms.sum(axis=1)[dark]
        beside = scene.tips[slipped][:, None] - scene.plane.centers[dark]
        apart = (np.hypot(*np.moveaxis(beside, -1, 0)) > reach).all(axis=0)
        assert apart.any() and (image.verdict[dark][apart] == told).all()
        known.learn(image)


def test_a_fibre_that_was_ever_seen_is_not_told_as_dark_but_as_missing(scene):
    known = Knowledge(scene.plane, half_rad=np.full((N, 2), 1e-3))
    known.begin(scene.before, False)
    lit = np.arange(N) != 8
    for shines, told in (
        (lit, Verdict.MISSING),
        (~lit | lit, Verdict.MEASURED),
        (lit, Verdict.MISSING),
    ):
        spots = [exposure.spots for exposure in scene.expose(shines)]
        expected = known.expected(scene.counters)
        image = measure(expected, spots, scene.fiducials, scene.camera.calibrated)
        assert image.verdict[8] == told
        known.learn(image)


def test_a_merged_spot_in_every_exposure_tells_no_place(scene):
    image = scene.measure(scene.expose(merged=0.1, exposures=1))
    merged = image.verdict == Verdict.MERGED
    assert merged.sum() > 4 and np.isnan(image.places[merged]).all()
    off = np.hypot(*(image.places - scene.tips).T)
    assert np.nanmax(off) < 0.08


def test_an_unseen_robot_keeps_the_angles_of_its_counters_with_the_errors_of_its_drive(scene):
    lit = np.arange(N) > 2
    image = scene.measure(scene.expose(lit))
    assert (image.verdict[:3] == Verdict.MISSING).all() and not follows(image)[:3].any()
    np.testing.assert_array_equal(image.angles[:3], scene.counters[:3])
    # two numbers that are each within 4 sigma of 40 um at the end of an arm of 3 mm
    assert (image.interval_rad[:3] > 4 * 0.04 / 3.0).all()


def test_bad_expectations_are_refused_with_the_robot(scene):
    counters = scene.counters.copy()
    counters[5, 0] = np.nan
    with pytest.raises(MetrologyError, match=f"robot {scene.plane.ids[5]}: counters is not finite"):
        scene.expected(counters=counters)
    with pytest.raises(MetrologyError, match="error_um must be positive"):
        scene.expected(error_um=0.0)
    with pytest.raises(MetrologyError, match="sigmas"):
        MeasureConfig(sigmas=0.0)


def test_theta_of_a_folded_arm_is_known_as_well_as_its_drive_keeps_it(scene):
    scene.counters[:, 1] = scene.true[:, 1] = np.pi - 1e-3
    scene.true[:] = scene.counters + np.deg2rad(scene.rng.uniform(-0.4, 0.4, (N, 2))) * [1.0, 0.0]
    image = scene.measure(scene.expose(), before=scene.counters, before_rad=np.full((N, 2), 0.01))
    assert image.certain.all()
    assert image.interval_rad[:, 0].max() < 0.1
    assert (np.abs(image.angles - scene.true) <= image.interval_rad + 1e-6).all()
    # theta may have stuck: the image of a folded arm cannot tell
    stuck = scene.counters + [0.7, 0.0]
    image = scene.measure(scene.expose(), before=stuck, before_rad=np.full((N, 2), 0.01))
    low, high = image.angles - image.interval_rad, image.angles + image.interval_rad
    assert (low < scene.counters + 1e-9).all() and (high > stuck - 1e-9).all()
    # images alone do not make it worse
    again = scene.measure(scene.expose(), before=image.angles, before_rad=image.interval_rad,
                          counters=image.angles)  # fmt: skip
    wider = again.interval_rad - image.interval_rad
    assert wider.max() < 0.1


def test_what_a_long_move_may_be_off_is_no_sign_of_a_joint_that_stuck():
    plane = preset("desi", 7)
    drive, config = DriveErrors(), MeasureConfig()
    before = np.tile([-3.0, 1.5], (7, 1))
    after = before.copy()
    after[:, 0] += np.linspace(0.0, 6.2, 7)
    after[:, 1] += 0.05
    error_um = drive.after_um(plane, before, after)
    assert (np.diff(error_um) > 0.0).all() and 20.0 <= error_um[0] < 21.0
    # 6.2 rad at the radius of the fibre, 0.4 % of it
    radius_mm = np.hypot(*(kinematics.forward(plane, after)[1] - plane.centers)[-1])
    assert error_um[-1] == pytest.approx(np.hypot(20.0, 4.0 * 6.2 * radius_mm), rel=1e-3)
    judged_mm = config.judged_mm(error_um)
    assert judged_mm[0] == pytest.approx(0.3)
    assert judged_mm[-1] == pytest.approx(0.012 * error_um[-1])


def test_a_joint_that_stuck_too_near_for_a_verdict_is_found_where_it_is():
    # 0.25 mm are twelve of its errors and less than a verdict needs
    scene = Scene(3)
    short = np.arange(N) % 7 == 0
    scene.before[short] = scene.counters[short] - [0.0, 0.25 / 3.0]
    inside = scene.before[:, 1] > scene.plane.limits[:, 1, 0]
    short &= inside
    scene.true[short] = np.stack([scene.counters[:, 0], scene.before[:, 1]], axis=1)[short]
    drive = DriveErrors()
    arguments = scene.plane, scene.before, scene.counters
    error_um, joints_rad = drive.after_um(*arguments), drive.joints_rad(*arguments)
    assert error_um[short].max() < 21.0
    image = scene.measure(scene.expose(), error_um=error_um, joints_rad=joints_rad)
    assert image.certain[short].all() and not image.not_moved[short].any()
    assert (image.verdict[short] == Verdict.OFF_MODEL).all()
    off = np.hypot(*(image.places - scene.tips).T)
    assert (off < image.error_mm)[short].all()


def test_a_joint_that_stuck_has_no_error_of_its_drive_there():
    # a light 120 um from where the fibre should be makes the fibre that stuck doubtful, and less so
    # the better its place is known
    scene = Scene(4)
    drive = DriveErrors()
    arguments = scene.plane, scene.before, scene.counters
    error_um, joints_rad = drive.after_um(*arguments), drive.joints_rad(*arguments)
    np.testing.assert_allclose(
        1e3 * np.hypot(*(joints_rad * drive_levers(scene.plane, scene.counters)).T), error_um
    )
    scene.true[0, 0], scene.true[0, 1] = scene.before[0, 0], scene.counters[0, 1]
    exposures = scene.expose()
    by_fibre = scene.measure(exposures, error_um=error_um)
    by_joint = scene.measure(exposures, error_um=error_um, joints_rad=joints_rad)
    for image in (by_fibre, by_joint):
        assert image.verdict[0] == Verdict.THETA_NOT_MOVED
    assert by_joint.doubt[0] < 0.5 * by_fibre.doubt[0]
    for bad in (-joints_rad, joints_rad[1:]):
        with pytest.raises(MetrologyError, match="joints_rad"):
            scene.expected(joints_rad=bad)


def drive_levers(plane, angles):
    tips = kinematics.forward(plane, angles)[1] - plane.centers
    return np.stack([np.hypot(*tips.T), plane.arms[:, 1]], axis=1)


def test_outlines_of_an_unseen_robot_hold_what_its_own_move_leaves_and_nothing_if_it_rested(scene):
    rested = np.arange(N) % 2 == 0
    scene.counters[rested] = scene.before[rested]
    scene.true[rested] = scene.before[rested]
    known = Knowledge(scene.plane, half_rad=np.zeros((N, 2)))
    known.begin(scene.before, False)
    dark = np.arange(N) < 40
    spots = [exposure.spots for exposure in scene.expose(~dark)]
    expected = known.expected(scene.counters)
    image = measure(expected, spots, scene.fiducials, scene.camera.calibrated)
    off_mm = known.outlines_off_mm(image)
    unseen = ~image.certain
    assert unseen[:40].all()
    assert (off_mm[unseen & rested] == 0.0).all() and (off_mm[unseen & ~rested, 1] > 0.0).all()
    moved = np.flatnonzero(unseen & ~rested)
    order = np.argsort(np.asarray(expected.error_um)[moved])
    assert (np.diff(off_mm[moved[order], 1]) >= -1e-12).all()


def test_theta_that_stuck_almost_a_turn_from_where_it_should_be_is_told_with_its_turn():
    # 345 deg were ordered and the fibre is 15 deg from where it should be: too near for a verdict,
    # and nearer to a turn more than to where the joint rests
    scene, drive = Scene(5), DriveErrors()
    scene.counters[:, 1] = scene.before[:, 1] = 1.9
    scene.before[:, 0], scene.counters[:, 0] = -3.0, -3.0 + np.deg2rad(345.0)
    scene.true = scene.before.copy()
    told = scene.plane, scene.before, scene.counters
    image = scene.measure(
        scene.expose(), error_um=drive.after_um(*told), joints_rad=drive.joints_rad(*told)
    )
    assert image.certain.mean() > 0.9 and not np.isin(image.verdict, STILL).any()
    off = np.abs(image.angles - scene.true)[image.certain]
    assert (off <= image.interval_rad[image.certain] + 1e-9).all()


@pytest.mark.parametrize("seed", [1, 2])
def test_robots_of_another_field_between_our_fiducials_are_refused_as_another_plane(scene, seed):
    rng = np.random.default_rng(seed)
    scene.true = np.array(random_field(scene.plane, rng).goal)  # nothing known brought them there
    known = Knowledge(scene.plane)
    known.begin(scene.before, False)
    spots = [exposure.spots for exposure in scene.expose(exposures=3)]
    expected = known.expected(scene.counters)
    with pytest.raises(ImageError, match=r"\d+ robots are at \d+ lights: the image is of another"):
        measure(expected, spots, scene.fiducials, scene.camera.calibrated)
