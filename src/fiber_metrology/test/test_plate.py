# SPDX-License-Identifier: Apache-2.0
"""The plate solution: fiducials are found, distortion is fitted, bad images are refused by name."""

import numpy as np
import pytest
from metrology_scene import Scene

from fiber_metrology import (
    ImageError,
    MetrologyError,
    PlateConfig,
    Spots,
    checked_spots,
    combine,
    fit_map,
    solve_plate,
)


def spots_of(scene, **changes):
    return scene.expose(exposures=1, **changes)[0]


def test_a_polynomial_is_found_again_and_needs_enough_points():
    rng = np.random.default_rng(1)
    points = rng.uniform(-300, 300, (60, 2))
    made = fit_map(points, 1e-6 * points**3 + points[:, ::-1] * points[:, :1], 3)
    others = rng.uniform(-200, 200, (9, 2))
    np.testing.assert_allclose(
        made(others), 1e-6 * others**3 + others[:, ::-1] * others[:, :1], atol=1e-8
    )
    with pytest.raises(MetrologyError, match="9 points do not fix a map of 10 terms"):
        fit_map(points[:9], points[:9], 3)


def test_without_air_and_noise_every_spot_is_where_its_fibre_is(scene):
    exposure = spots_of(scene, turbulence_um=0.0, noise_um=0.0)
    plate = solve_plate(exposure.spots, scene.fiducials, scene.camera.calibrated)
    fibre = exposure.owner >= 0
    off = plate.places[fibre] - scene.tips[exposure.owner[fibre]]
    assert np.abs(off).max() < 1e-3  # a micrometre, of a distortion of a millimetre
    np.testing.assert_array_equal(plate.fiducial >= 0, exposure.owner == scene.camera.FIDUCIAL)
    assert plate.residual_um < 1.0


def test_the_residual_is_that_of_air_and_noise(scene):
    exposure = spots_of(scene)
    plate = solve_plate(exposure.spots, scene.fiducials, scene.camera.calibrated)
    assert 1.0 < plate.residual_um < 7.0
    fibre = exposure.owner >= 0
    off = plate.places[fibre] - scene.tips[exposure.owner[fibre]]
    assert np.sqrt((off**2).sum(axis=1).mean()) < 8e-3


def moved(spots, by_px):
    return spots._replace(place_px=spots.place_px + by_px)


def test_bad_images_are_refused_with_the_reason(scene):
    good, fiducials = spots_of(scene).spots, scene.fiducials
    calibrated = scene.camera.calibrated
    none = Spots(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    few = Spots(*(column[:12] for column in good))
    cases = [
        (none, "no spots: no light"),
        (few, "has 12 spots, and 28 of 40 fiducials"),
        (moved(good, [20.0, 0.0]), r"shifted by -?[23]\.\d+, -?0\.\d+ mm, more than 1 mm"),
        (moved(good, [400.0, 0.0]), "another plane, turned, or shifted by more than 8 mm"),
    ]
    for spots, message in cases:
        with pytest.raises(ImageError, match=message):
            solve_plate(spots, fiducials, calibrated)
    other = Scene(seed=3)
    with pytest.raises(ImageError, match="agree on a shift"):
        solve_plate(good, other.rng.uniform(-80, 80, (40, 2)), calibrated)
    with pytest.raises(ImageError, match="um rms from their places, more than 0.5 um"):
        solve_plate(good, fiducials, calibrated, PlateConfig(residual_um=0.5))
    with pytest.raises(ImageError, match="the camera gave no image"):
        combine([], fiducials, calibrated)
    with pytest.raises(MetrologyError, match="flux has shape"):
        checked_spots(good.place_px, good.flux[1:], good.width_px)
    with pytest.raises(MetrologyError, match="found"):
        PlateConfig(found=2.0)


def test_spots_that_are_not_finite_are_left_out(scene):
    good = spots_of(scene).spots
    place = good.place_px.copy()
    place[3] = np.nan
    assert len(checked_spots(place, good.flux, good.width_px).flux) == len(good.flux) - 1


def test_half_of_the_fiducials_covered_is_too_few_and_a_fifth_is_not(scene):
    exposure = spots_of(scene)
    fiducial = np.flatnonzero(exposure.owner == scene.camera.FIDUCIAL)
    for covered, fits in ((8, True), (20, False)):
        kept = np.delete(np.arange(len(exposure.owner)), fiducial[:covered])
        spots = Spots(*(column[kept] for column in exposure.spots))
        if fits:
            plate = solve_plate(spots, scene.fiducials, scene.camera.calibrated)
            assert (plate.fiducial >= 0).sum() == 32
        else:
            with pytest.raises(ImageError, match="only 20 of 40"):
                solve_plate(spots, scene.fiducials, scene.camera.calibrated)
