# SPDX-License-Identifier: Apache-2.0
"""What a camera and the metrology send comes back unchanged, or is refused by robot and value."""

import numpy as np
import pytest
from sensor_msgs.msg import Image

from fiber_msgs_py import (
    MessageError,
    PlanStamp,
    images,
    lights,
    measured,
    session_of,
    spots,
    targets,
    true_places,
    turns,
)
from fiber_msgs_py.true_places import TruePlaces


def table(n=3):
    nan = np.array([[0.1, 0.2], [np.nan, np.nan], [1e3, -4.0]])[:n]
    return measured.Measured(
        np.arange(n) + 7, np.array([0, 2, 5])[:n], nan, np.ones((n, 2)), np.full((n, 2), 1e-3),
        np.where(np.isnan(nan[:, 0]), np.nan, 0.01), np.zeros(n), np.full((n, 2), 0.2),
    )  # fmt: skip


def test_measured_comes_back():
    sent = table()
    got = measured.decode(measured.encode(sent, PlanStamp(5)))
    for name in sent._fields:
        np.testing.assert_allclose(getattr(got, name), getattr(sent, name), rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"verdict": np.array([0, 99, 5])}, "robot 8.*verdict"),
        ({"angles": np.full((3, 2), np.nan)}, "robot 7.*theta"),
        ({"wider_mm": np.full((3, 2), -1.0)}, "robot 7.*theta_wider"),
        ({"error_mm": np.zeros(3)}, "robot 8.*error.*does not fit x"),
        ({"places": np.full((3, 2), np.inf)}, "robot 7"),
        ({"half_rad": np.zeros((2, 2))}, "shape"),
        ({"ids": np.array([7, 7, 8])}, "twice"),
    ],
)
def test_what_no_metrology_measures_is_refused(change, words):
    with pytest.raises(MessageError, match=words):
        measured.encode(table()._replace(**change), PlanStamp(5))


def test_spots_and_calibration_come_back():
    px = np.array([[1.5, 2.5], [3.0, 4.0]])
    got = spots.decode(spots.encode(px, [1.0, 2.0], [0.5, 0.6], PlanStamp(5)))
    assert np.array_equal(got[0], px) and got[1].tolist() == [1.0, 2.0]
    seen = np.array([[5.0, 6.0], [np.nan, np.nan]])
    plane, place, fiducial = spots.decode_calibration(
        spots.encode_calibration(px, seen, [False, True], PlanStamp(5))
    )
    np.testing.assert_allclose(plane, px)
    np.testing.assert_array_equal(place, seen)
    assert fiducial.tolist() == [False, True]
    with pytest.raises(MessageError, match="flux"):
        spots.encode(px, [1.0], [0.5, 0.6], PlanStamp(5))
    with pytest.raises(MessageError, match="row 1 is no place"):
        spots.encode_calibration(seen, px, [0, 0], PlanStamp(5))


def test_true_places_come_back_or_are_refused_by_robot():
    sent = TruePlaces(np.array([7, 9]), np.array([[1.5, -2.5], [300.0, 4.0]]))
    got = true_places.decode(true_places.encode(sent, PlanStamp(5)))
    assert got.ids.tolist() == [7, 9]
    np.testing.assert_allclose(got.places, sent.places, rtol=1e-14)
    with pytest.raises(MessageError, match="shape of places"):
        true_places.encode(sent._replace(places=np.zeros((3, 2))), PlanStamp(5))
    nowhere = sent._replace(places=np.array([[1.5, -2.5], [np.nan, 4.0]]))
    with pytest.raises(MessageError, match="robot 9.*no place"):
        true_places.decode(true_places.encode(nowhere, PlanStamp(5)))


@pytest.mark.parametrize("big", [False, True])
def test_images_of_both_byte_orders_and_with_longer_rows_come_back(big):
    pixels = np.arange(12, dtype=np.uint16).reshape(3, 4) * 1000
    message = images.encode(pixels, PlanStamp(5))
    assert np.array_equal(images.decode(message), pixels)
    rows = pixels.astype(">u2" if big else "<u2").view(np.uint8).reshape(3, 8)
    data = np.concatenate([rows, np.zeros((3, 2), np.uint8)], axis=1)
    message = Image(
        height=3, width=4, encoding="mono16", is_bigendian=int(big), step=10, data=data.tobytes()
    )
    assert np.array_equal(images.decode(message), pixels)


def test_what_is_no_image_is_refused():
    with pytest.raises(MessageError, match="encoding"):
        images.decode(Image(encoding="rgb8"))
    with pytest.raises(MessageError, match="too few"):
        images.decode(Image(height=3, width=4, encoding="mono16", step=8, data=bytes(9)))


def test_targets_of_a_correction_say_so():
    for straight in (False, True):
        message = targets.encode([4], [[0.0, 1.0]], PlanStamp(5), straight=straight)
        assert targets.decode_straight(message) is straight
        assert targets.decode(message)[0].tolist() == [4]


def test_turns_and_lights_come_back_with_their_session():
    message = turns.encode([4, 9, 2], [1, -1, 0], PlanStamp(5), "session_0123456789abcdef01234567")
    got = turns.decode(message)
    assert got.ids.tolist() == [4, 9, 2] and got.way.tolist() == [1, -1, 0]
    to_stops = [turns.TO_UPPER_STOP, turns.TO_LOWER_STOP]
    assert turns.decode(turns.encode([4, 9], to_stops, PlanStamp(5))).way.tolist() == to_stops
    assert session_of(message) == "session_0123456789abcdef01234567"
    sent = lights.SeenLights(np.array([[1.5, -2.0], [0.0, 400.0]]), [3, 1], [False, True])
    seen = lights.decode(lights.encode(sent, PlanStamp(5), "session_0123456789abcdef01234567"))
    np.testing.assert_allclose(seen.places, sent.places)
    assert seen.seen.tolist() == [3, 1] and seen.merged.tolist() == [False, True]
    assert (
        len(lights.decode(lights.encode(lights.SeenLights([], [], []), PlanStamp(5))).places) == 0
    )


@pytest.mark.parametrize(
    ("ids", "way", "words"),
    [
        ([4], [3], "robot 4.*way.*3"),
        ([4, 4], [1, 1], "twice"),
        ([4], [1, 1], "shape of way"),
        ([4, 9], [1, 2], "robot 9.*way.*2.*other robots turn phi"),
    ],
)
def test_turns_that_no_robot_makes_are_refused(ids, way, words):
    with pytest.raises(MessageError, match=words):
        turns.encode(ids, way, PlanStamp(5))


def test_lights_beyond_any_plane_are_refused():
    for place in ([np.nan, 0.0], [1e6, 0.0]):
        with pytest.raises(MessageError, match="row 0 is no place"):
            lights.encode(lights.SeenLights([place], [1], [False]), PlanStamp(5))
