# SPDX-License-Identifier: Apache-2.0
"""The simulated camera: as much air, noise and mishap as asked for, seeded."""

import numpy as np
import pytest
from metrology_scene import N, Scene

from fiber_core.presets import preset
from fiber_metrology import MetrologyError
from fiber_metrology.camera import CameraConfig, SimulatedCamera, fiducial_places, turbulence
from fiber_metrology.camera.node import SimulatedScene, _arm_of


def test_air_moves_near_places_alike_and_far_ones_apart():
    rng = np.random.default_rng(2)
    pairs = rng.uniform(-400, 400, (400, 2))
    near, middle = pairs + [5.0, 0.0], pairs + [50.0, 0.0]
    one = np.concatenate(
        [turbulence(np.concatenate([pairs, near, middle]), 5e-3, 50.0, rng) for _ in range(20)]
    ).reshape(20, 3, 400, 2)
    size = np.sqrt((one**2).sum(axis=3).mean())
    assert size == pytest.approx(5e-3, rel=0.1)
    alike = [(one[:, 0] * one[:, k]).mean() / (one[:, 0] ** 2).mean() for k in (1, 2)]
    assert alike[0] > 0.98
    assert alike[1] == pytest.approx(np.exp(-0.5), abs=0.08)  # exp(-r^2 / 2 L^2) at r = L


def test_the_same_seed_gives_the_same_spots():
    one, two = (Scene(seed=5, camera=CameraConfig()).expose(exposures=1)[0] for _ in range(2))
    assert one.spots.place_px.tobytes() == two.spots.place_px.tobytes()
    assert one.owner.tobytes() == two.owner.tobytes()


def test_dark_missing_stray_and_merged_spots_are_as_many_as_asked_for(scene):
    lit = np.arange(N) % 2 == 0
    dark = scene.expose(lit, 1)[0]
    assert set(dark.owner[dark.owner >= 0]) == set(np.flatnonzero(lit))
    owners = np.concatenate([e.owner for e in scene.expose(None, 40, missing=0.1, stray=0.2)])
    assert (owners >= 0).sum() == pytest.approx(40 * N * 0.9, rel=0.02)
    assert (owners == scene.camera.STRAY).sum() == pytest.approx(40 * N * 0.18, rel=0.1)
    usual = scene.expose(None, 1, missing=0.0, stray=0.0)[0].spots
    merged = scene.expose(None, 20, merged=1.0)
    flux = np.concatenate([e.spots.flux[e.owner >= 0] for e in merged])
    assert np.median(flux) > 1.6 * np.median(usual.flux[usual.flux < 2e4])


def test_fiducials_stand_between_robots_and_over_the_whole_plane():
    plane = preset("desi", 400)
    places = fiducial_places(plane, 60)
    assert len(np.unique(places, axis=0)) == 60
    apart = np.hypot(*(places[:, None] - plane.centers[None]).transpose(2, 0, 1))
    assert apart.min() > 5.0
    assert np.hypot(*places.T).max() > 0.9 * np.hypot(*plane.centers.T).max()
    with pytest.raises(MetrologyError, match="no gap"):
        fiducial_places(preset("desi", 1))


def test_bad_settings_are_refused():
    with pytest.raises(MetrologyError, match="missing"):
        CameraConfig(missing=1.5)
    with pytest.raises(MetrologyError, match="radius_mm"):
        SimulatedCamera(0.0, CameraConfig(), np.random.default_rng(0))


def test_swapped_plugs_are_pairs_of_different_robots_of_the_plane():
    assert SimulatedScene(swapped="3-17, 8-9").pairs() == [(3, 17), (8, 9)]
    assert SimulatedScene().pairs() == []
    for wrong in ("3", "3-17, 17-4", "5-5", "a-b"):
        with pytest.raises(MetrologyError, match="no list of pairs"):
            SimulatedScene(swapped=wrong)
    plane = preset("desi", 20)
    assert _arm_of(plane, [(3, 17)])[[3, 17, 4]].tolist() == [17, 3, 4]
    with pytest.raises(MetrologyError, match="no robot 400"):
        _arm_of(plane, [(3, 400)])
