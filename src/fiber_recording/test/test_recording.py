# SPDX-License-Identifier: Apache-2.0
"""A recording is the same after saving and loading, and files of older versions still open."""

import json
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from fiber_core.drive import most_motors_on
from fiber_core.problem import load_problem
from fiber_recording import (
    Images,
    Recording,
    RecordingError,
    counts_at,
    load_recording,
    save_recording,
)
from fiber_recording.examples import seen_by_a_camera
from fiber_recording.recording_file import VERSION

DATA = Path(__file__).parent / "data"


def same(one, two, name=""):
    """Compare every array of two values; return the number of arrays."""
    if one is None or isinstance(one, (dict, str)):
        assert one == two, name
        return 1
    if is_dataclass(one):
        return sum(
            same(getattr(one, f.name), getattr(two, f.name), f"{name}.{f.name}")
            for f in fields(one)
        )
    if isinstance(one, tuple) and len(one) and is_dataclass(one[0]):
        assert len(one) == len(two)
        return sum(same(a, b, f"{name}[{k}]") for k, (a, b) in enumerate(zip(one, two)))
    if name.startswith(".corridors"):  # rounded inwards to a milliradian
        inward = {"low": two - one, "high": one - two}.get(name.split(".")[-1], np.zeros(1))
        assert -1e-7 < inward.min() and inward.max() < 1.001e-3, name
        return 1
    if isinstance(one, np.ndarray) and one.dtype.kind == "f":
        np.testing.assert_allclose(one, two, rtol=1e-6, atol=1e-6, err_msg=name)
    else:
        np.testing.assert_array_equal(one, two, err_msg=name)
    return 1


@pytest.mark.parametrize("name", ["recording", "resumed"])
def test_a_loaded_recording_equals_the_saved_one(request, name):
    recording, recording_file = (request.getfixturevalue(n) for n in (name, f"{name}_file"))
    assert same(recording, load_recording(recording_file)) > 44
    assert len(recording.phases) == 1 + (name == "resumed")
    read = load_recording(recording_file)
    for name in ("start", "ticks", "velocity"):
        np.testing.assert_array_equal(getattr(read.motion, name), getattr(recording.motion, name))
    np.testing.assert_array_equal(read.measured.counts, recording.measured.counts)
    assert np.abs(read.planned.angles - recording.planned.angles).max() <= 0.5001e-6


def test_planned_and_corridors_are_optional(recording, tmp_path):
    path = tmp_path / "no_curves.npz"
    save_recording(path, replace(recording, planned=None, corridors=None))
    assert load_recording(path).planned is None and load_recording(path).corridors is None


def test_images_sectors_and_supplies_come_back(recording, tmp_path):
    seen = seen_by_a_camera(recording, 1)
    path = tmp_path / "seen.npz"
    save_recording(path, seen)
    read = load_recording(path)
    assert same(seen.images, read.images) == 4
    assert read.images.names == seen.images.names
    assert read.problem.plane.sector.tolist() == seen.problem.plane.sector.tolist()
    assert read.problem.plane.drive == seen.problem.plane.drive
    save_recording(path, replace(seen, images=replace(seen.images, true_mm=None)))
    assert load_recording(path).images.true_mm is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"place_mm": np.zeros((2, 37))}, "image places"),
        ({"verdict": np.zeros((1, 37))}, "image verdict"),
        ({"true_mm": np.zeros((2, 36, 2))}, "image true_mm"),
        ({"verdict": np.full((2, 37), 99)}, "verdict 99 of an image has no name"),
    ],
)
def test_images_that_do_not_fit_are_refused(recording, changes, words):
    with pytest.raises(RecordingError, match=words):
        replace(seen_by_a_camera(recording, 1).images, **changes)


def test_images_of_another_plane_are_refused(recording):
    few = Images(np.zeros((1, 5, 2)), np.zeros((1, 5)))
    with pytest.raises(RecordingError, match="images has 5 robots, the plane has 37"):
        replace(recording, images=few)


def test_the_motors_of_each_supply_are_counted(recording, recording_file, tmp_path):
    seen = seen_by_a_camera(recording, 1)
    path = tmp_path / "seen.npz"
    save_recording(path, seen)
    data, plane = np.load(path), seen.problem.plane
    most = data["supply_turning"].max(axis=1) / data["supply_motors"]
    np.testing.assert_allclose(most, most_motors_on(seen.executed, plane.supply))
    assert "supply_turning" not in np.load(recording_file)  # without a cap


def test_a_recording_opens_as_a_problem(recording, recording_file):
    problem = load_problem(recording_file)
    np.testing.assert_array_equal(problem.start, recording.problem.start)
    np.testing.assert_array_equal(problem.plane.phi_vertices, recording.problem.plane.phi_vertices)
    assert problem.plane.name == "desi"


def test_saving_is_repeatable_and_leaves_no_other_file(recording, tmp_path):
    for name in "ab":
        save_recording(tmp_path / f"{name}.npz", recording)
    one, two = (dict(np.load(tmp_path / f"{name}.npz")) for name in "ab")
    assert {k: v.tobytes() for k, v in one.items()} == {k: v.tobytes() for k, v in two.items()}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.npz", "b.npz"]


def test_counts_of_the_orders_agree_with_the_motion(recording):
    motion, rng = recording.executed, np.random.default_rng(0)
    row = rng.integers(0, len(recording.outcome), 400)
    time_us = rng.integers(-100_000, 4_000_000, 400)
    counts = counts_at(recording.phases, row, time_us)
    exact = np.array([motion(t)[r] for r, t in zip(row, time_us * 1e-6)])
    off = recording.units.to_angles(counts) - exact
    assert np.abs(off).max() < 1.001 * 5 * recording.units.quantum_rad  # floored in each segment
    ends = counts_at(recording.phases, np.arange(len(motion.start)), np.full(motion.n, 10**9))
    np.testing.assert_array_equal(ends, recording.motion.end)


def changed(path, tmp_path, **about):
    data = dict(np.load(path))
    changed_about = json.loads(bytes(data["about"])) | about
    data["about"] = np.frombuffer(json.dumps(changed_about).encode(), np.uint8)
    np.savez(tmp_path / "changed.npz", **data)
    return tmp_path / "changed.npz"


def test_a_newer_version_is_refused_by_number(recording_file, tmp_path):
    with pytest.raises(RecordingError, match=r"version 99, this software reads versions up to 2"):
        load_recording(changed(recording_file, tmp_path, version=99))


def test_a_file_that_is_not_a_recording_is_refused(recording_file, tmp_path):
    np.savez(tmp_path / "other.npz", a=[1])
    (tmp_path / "text.npz").write_text("hello")
    other = changed(recording_file, tmp_path, format="something else")
    for path in (tmp_path / "other.npz", tmp_path / "text.npz", tmp_path / "none.npz", other):
        with pytest.raises(RecordingError, match="not a recording"):
            load_recording(path)


@pytest.mark.parametrize("name", ["ticks", "outcome", "event_kind"])
def test_a_missing_array_is_named(recording_file, tmp_path, name):
    data = dict(np.load(recording_file))
    del data[name]
    np.savez(tmp_path / "part.npz", **data)
    with pytest.raises(RecordingError, match=name):
        load_recording(tmp_path / "part.npz")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("outcome", np.zeros(3, int), "outcome has shape"),
        ("started", np.zeros(2, bool), "started has shape"),
    ],
)
def test_an_array_that_does_not_fit_the_plane_is_refused(recording, field, value, message):
    with pytest.raises(RecordingError, match=message):
        replace(recording, **{field: value})


def test_an_unknown_robot_is_named(recording):
    with pytest.raises(RecordingError, match=r"\[999\]"):
        recording.rows_of([1, 999])


@pytest.mark.parametrize("path", sorted(DATA.glob("recording-*.npz")), ids=lambda path: path.stem)
def test_recordings_of_older_versions_still_open(path):
    read = load_recording(path)
    assert isinstance(read, Recording)
    # values that were recorded with the file
    expected = json.loads((DATA / f"{path.stem}.json").read_text())
    plane = read.problem.plane
    assert plane.n == expected["robots"] and plane.name == expected["plane"]
    assert read.executed.makespan_s == pytest.approx(expected["makespan_s"])
    assert read.measured.counts.sum() == expected["sum_of_counts"]
    assert read.outcome.tolist() == expected["outcome"]
    assert read.about["seed"] == expected["seed"]


def test_there_is_a_recording_of_every_version():
    assert {p.stem for p in DATA.glob("*.npz")} == {f"recording-{v}" for v in range(1, VERSION + 1)}
