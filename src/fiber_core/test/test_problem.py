# SPDX-License-Identifier: Apache-2.0
"""Exchange files are read as they were written, by this or by another program."""

from dataclasses import fields, replace

import numpy as np
import pytest

from fiber_core import (
    PRESETS,
    LayoutError,
    MotionError,
    Outcome,
    Problem,
    SegmentMotion,
    load_plan,
    load_problem,
    preset,
    save_plan,
    save_problem,
)


def some_problem(name="desi", robots=19):
    rng = np.random.default_rng(4)
    plane = preset(name, robots).with_enabled(rng.random(robots) < 0.8)
    plane = replace(plane, obstacles=rng.random((2, 3)))
    targets = plane.centers + rng.normal(size=(robots, 2))
    targets[::3] = np.nan
    return Problem(plane, rng.normal(size=(robots, 2)), targets)


@pytest.mark.parametrize("name", PRESETS)
def test_a_problem_survives_its_file_bit_by_bit(name, tmp_path):
    problem = some_problem(name)
    save_problem(tmp_path / "problem.npz", problem)
    back = load_problem(tmp_path / "problem.npz")
    for column in fields(problem.plane):
        if column.name == "drive":  # it has a test of its own
            assert back.plane.drive.is_ideal
            continue
        assert np.array_equal(getattr(back.plane, column.name), getattr(problem.plane, column.name))
    assert np.array_equal(back.start, problem.start)
    assert np.array_equal(back.targets, problem.targets, equal_nan=True)
    assert np.array_equal(back.asked, np.arange(19) % 3 != 0)


CONTRACT = (
    "id center_mm arm_mm radius_mm start_rad target_mm enabled speed_rad_s limits_rad disc_mm"
).split()


def contract_fields(tmp_path, problem):
    save_problem(tmp_path / "all.npz", problem)
    with np.load(tmp_path / "all.npz") as file:
        return {name: file[name] for name in CONTRACT}


def test_a_file_with_the_required_fields_alone_is_enough(tmp_path):
    problem = some_problem()
    np.savez(tmp_path / "minimal.npz", **contract_fields(tmp_path, problem))
    plane = load_problem(tmp_path / "minimal.npz").plane
    assert np.array_equal(plane.phi_vertices, problem.plane.phi_vertices)  # a capsule, as preset
    assert plane.theta_vertices.shape == (19, 0, 2)
    assert plane.spacing_mm == 0.0 and plane.envelope_mm == 4 * problem.plane.phi_radius.max()
    assert np.array_equal(plane.obstacles, problem.plane.obstacles)
    assert len(set(zip(plane.bus, plane.address))) == 19


@pytest.mark.parametrize("missing", [name for name in CONTRACT if name != "disc_mm"])
def test_a_missing_field_is_named(missing, tmp_path):
    data = contract_fields(tmp_path, some_problem())
    del data[missing]
    np.savez(tmp_path / "short.npz", **data)
    with pytest.raises(LayoutError, match=f"short.npz has no field {missing}"):
        load_problem(tmp_path / "short.npz")


@pytest.mark.parametrize(
    "name, value, words",
    [
        ("arm_mm", np.ones(19), ["arm_mm", "(19,)"]),
        ("start_rad", np.full((19, 2), np.nan), ["robot 0", "start", "nan"]),
        ("target_mm", np.full((19, 2), np.inf), ["robot 0", "target", "inf"]),
        ("target_mm", np.array([[np.nan, 1.0]] * 19), ["robot 0", "target"]),
        ("target_mm", np.zeros((18, 2)), ["targets", "(18, 2)"]),
        ("id", np.zeros(19), ["ids must increase"]),
        ("speed_rad_s", np.zeros((19, 2)), ["robot 0", "speeds"]),
        ("enabled", np.array(["yes"] * 19), ["enabled"]),
    ],
)
def test_a_bad_field_is_named(name, value, words, tmp_path):
    data = contract_fields(tmp_path, some_problem())
    np.savez(tmp_path / "bad.npz", **{**data, name: value})
    with pytest.raises(LayoutError) as refusal:
        load_problem(tmp_path / "bad.npz")
    assert all(word in str(refusal.value) for word in words), str(refusal.value)


@pytest.mark.parametrize("content", [b"", b"id,x,y\n", b"PK\x03\x04 torn", None])
def test_another_file_is_refused(content, tmp_path):
    if content is not None:
        (tmp_path / "torn.npz").write_bytes(content)
    with pytest.raises(LayoutError, match="torn.npz is not a problem or plan file"):
        load_problem(tmp_path / "torn.npz")
    with pytest.raises(MotionError, match="torn.npz is not a problem or plan file"):
        load_plan(tmp_path / "torn.npz", np.zeros((1, 2)))


def test_a_plan_survives_its_file(tmp_path):
    rng = np.random.default_rng(0)
    start, outcome = rng.normal(size=(3, 2)), np.array([0, 1, 2])
    motion = SegmentMotion(start, [0, 1, 1, 3, 3, 4, 4], rng.random(4) + 0.1, rng.normal(size=4))
    save_plan(tmp_path / "plan.npz", motion, outcome, [0, 1, 61])
    back, read = load_plan(tmp_path / "plan.npz", start)
    assert np.array_equal(read, outcome)
    for name in ("start", "offsets", "duration_s", "velocity_rad_s"):
        assert np.array_equal(getattr(back, name), getattr(motion, name))
    with np.load(tmp_path / "plan.npz") as file:
        assert [file["outcome_names"][o] for o in Outcome] == ["reached", "held", "failed"]
    with pytest.raises(MotionError, match="offsets"):
        load_plan(tmp_path / "plan.npz", start[:2])
