# SPDX-License-Identifier: Apache-2.0
"""Spots in pixels: their places, their light, and images that show none."""

import numpy as np
import pytest
from metrology_scene import Scene
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from fiber_metrology import CentroidConfig, ImageError, MetrologyError, find_spots, measure


def pixels(places, light=2e4, side=200, sigma=1.5, seed=0, level=300.0):
    """An image by a library's filter: light that falls on pixels, then the noise of reading."""
    grid = 8
    fine = np.zeros((side * grid // 1, side * grid))
    for x, y in places:
        fine[round((y + 0.5) * grid - 0.5), round((x + 0.5) * grid - 0.5)] += light
    fine = gaussian_filter(fine, sigma * grid, truncate=6.0)
    image = fine.reshape(side, grid, side, grid).sum(axis=(1, 3))
    rng = np.random.default_rng(seed)
    return np.clip(rng.poisson(image) + level + 5.0 * rng.normal(size=image.shape), 0, 65535)


def on_fine_grid(rng, count, side):
    return np.rint(rng.uniform(20, side - 20, (count, 2)) * 8) / 8 + 1 / 16


def test_places_light_and_width_are_those_of_the_spots():
    rng = np.random.default_rng(1)
    places = on_fine_grid(rng, 40, 200)
    places = places[cKDTree(places).query(places, k=2)[0][:, 1] > 14.0]
    found = find_spots(pixels(places))
    assert len(found.flux) == len(places)
    off, which = cKDTree(places).query(found.place_px)
    assert len(set(which)) == len(places)
    # photons alone leave sigma / sqrt(light) along each axis
    photons_px = 1.5 / np.sqrt(2e4)
    assert np.sqrt(np.mean(off**2) / 2.0) < 1.6 * photons_px
    assert abs(np.mean(found.place_px - places[which], axis=0)).max() < photons_px
    assert np.median(found.flux) == pytest.approx(2e4, rel=0.02)
    # a pixel is a window of its own: its variance is 1/12
    assert np.median(found.width_px) == pytest.approx(np.hypot(1.5, 1 / np.sqrt(12)), rel=0.02)


def test_two_spots_beside_each_other_are_two():
    places = np.array([[60.0625, 60.0625], [66.5625, 60.0625]])
    found = find_spots(pixels(places))
    off, which = cKDTree(places).query(found.place_px)
    assert sorted(which) == [0, 1] and off.max() < 0.3


def test_a_spot_brighter_than_the_camera_tells_no_place():
    image = pixels(np.array([[60.0625, 60.0625], [120.0625, 90.0625]]))
    image[image > image.max() - 1.0] = 65535.0
    found = find_spots(image)
    assert len(found.flux) == 1


@pytest.mark.parametrize(
    ("image", "text"),
    [
        (pixels(np.zeros((0, 2))), "no light"),
        (np.full((100, 100), 7, dtype=np.uint16), "no light"),
        (np.where(np.arange(100)[:, None] % 2, 60000, 10) * np.ones((100, 100)), "pixels are lit"),
        (np.full((100, 100), np.nan), "not finite"),
    ],
)
def test_an_image_without_spots_says_why(image, text):
    with pytest.raises(ImageError, match=text):
        find_spots(image)


@pytest.mark.parametrize(
    "image", [np.zeros((10, 10)), np.zeros(100), np.zeros((90, 90), dtype=bool)]
)
def test_what_is_no_image_is_refused(image):
    with pytest.raises(MetrologyError):
        find_spots(image)


def test_an_image_gives_the_angles_that_spot_lists_give():
    scene = Scene(3)
    lit = np.ones(scene.plane.n, dtype=bool)
    shots = [scene.camera.photograph(scene.tips, scene.fiducials, lit, scene.rng) for _ in range(2)]
    spots = [find_spots(shot.pixels, CentroidConfig()) for shot in shots]
    image = measure(scene.expected(), spots, scene.fiducials, scene.camera.calibrated)
    sure = image.certain
    assert sure.mean() > 0.95
    off_um = 1e3 * np.hypot(*(image.places - scene.tips)[sure].T)
    assert np.sqrt(np.mean(off_um**2)) < 8.0
