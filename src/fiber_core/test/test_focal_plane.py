# SPDX-License-Identifier: Apache-2.0
"""A focal plane refuses bad columns, and every plane obeys some laws."""

from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest

from fiber_core import FocalPlane, LayoutError, forward, preset


def columns(**changes):
    plane = preset("desi_outlines", 7)
    arrays = [f.name for f in fields(plane) if f.name not in ("drive", "fibre_names")]
    values = {name: np.array(getattr(plane, name)) for name in arrays}
    values |= {"spacing_mm": 4.0, "envelope_mm": 5.0, "name": "seven"}
    values["ids"] = values["ids"] + 100
    for name, change in changes.items():
        values[name] = change(values[name]) if callable(change) else change
    return values


def at_row_3(value):
    def change(column):
        column = column.astype(float)
        column[3] = value
        return column

    return change


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"centers": at_row_3(np.nan)}, ["robot 103", "centers", "nan"]),
        ({"arms": at_row_3(0.0)}, ["robot 103", "arms", "0.0"]),
        ({"arms": at_row_3(np.inf)}, ["robot 103", "arms"]),
        ({"limits": at_row_3([[1.0, -1.0], [0.0, 1.0]])}, ["robot 103", "empty"]),
        ({"limits": at_row_3(np.nan)}, ["robot 103", "limits"]),
        ({"speeds": at_row_3(0.0)}, ["robot 103", "speeds"]),
        ({"phi_radius": at_row_3(-1.0)}, ["robot 103", "phi_radius", "-1.0"]),
        ({"phi_vertices": at_row_3(np.nan)}, ["robot 103", "phi_vertices"]),
        ({"theta_vertices": at_row_3(np.nan)}, ["robot 103", "theta_vertices"]),
        ({"theta_radius": at_row_3(np.nan)}, ["robot 103", "theta_radius"]),
        ({"ids": at_row_3(102)}, ["102 follows 102"]),
        ({"ids": at_row_3(103.5)}, ["ids", "103.5"]),
        ({"ids": at_row_3(np.nan)}, ["ids", "nan"]),
        ({"enabled": at_row_3(2)}, ["enabled", "2"]),
        ({"enabled": np.array(["False"] * 7)}, ["enabled"]),
        ({"centers": np.zeros((6, 2))}, ["centers", "(6, 2)", "(7, 2)"]),
        ({"limits": np.zeros((7, 2))}, ["limits", "(7, 2)"]),
        ({"phi_vertices": np.zeros((7, 0, 2))}, ["phi outline"]),
        ({"obstacles": [[0.0, np.nan, 1.0]]}, ["obstacle"]),
        ({"obstacles": [[0.0, 0.0, -1.0]]}, ["obstacle"]),
        ({"spacing_mm": -1.0}, ["spacing", "-1.0"]),
        ({"envelope_mm": -1.0}, ["envelope", "-1.0"]),
        ({"address": at_row_3(1)}, ["robots 100 and 103", "address 1 of bus 0"]),
    ],
)
def test_bad_columns_are_refused_by_name_and_value(changes, words):
    with pytest.raises(LayoutError) as refusal:
        FocalPlane(**columns(**changes))
    assert all(word in str(refusal.value) for word in words), str(refusal.value)


def test_a_plane_cannot_be_changed():
    given = columns()
    plane = FocalPlane(**given)
    given["centers"][:] = 0.0
    assert np.abs(plane.centers).max() > 10
    with pytest.raises(ValueError):
        plane.centers[0] = 0.0
    with pytest.raises(FrozenInstanceError):
        plane.arms = None


def test_arrays_that_cannot_be_written_to_are_shared_and_all_others_copied():
    plane = preset("desi_outlines", 7)
    same = plane.with_enabled(plane.enabled)
    assert same.centers is plane.centers and same.enabled is plane.enabled
    open_columns = columns()
    for name in ("centers", "arms"):
        open_columns[name].setflags(write=False)
    view = columns()["speeds"]
    owner = view.copy()
    view = owner[:]
    view.setflags(write=False)  # but its owner is not
    copied = FocalPlane(**{**open_columns, "speeds": view})
    owner[:] = 7.0
    assert copied.centers is open_columns["centers"]
    assert (copied.speeds != 7.0).all()
    assert not np.shares_memory(copied.limits, open_columns["limits"])


def test_index_of_inverts_ids_and_marks_unknown_ids():
    plane = FocalPlane(**columns(ids=np.array([3, 5, 8, 13, 21, 34, 55])))
    assert np.array_equal(plane.index_of(plane.ids), np.arange(7))
    assert np.array_equal(plane.index_of([4, 55, 56, -1, 3]), [-1, 6, -1, -1, 0])


def test_permuted_moves_every_column_together():
    plane, order = FocalPlane(**columns()), np.array([6, 2, 4])
    mixed = plane.permuted(order)
    assert np.array_equal(mixed.ids, [0, 1, 2])
    for name in ("centers", "arms", "limits", "phi_vertices", "enabled", "bus", "address"):
        assert np.array_equal(getattr(mixed, name), getattr(plane, name)[order])


def test_addresses_are_unique_on_each_bus():
    bus = np.array([7, 2, 7, 7, 2, 0, 2])
    plane = FocalPlane(**columns(bus=bus, address=None))
    assert np.array_equal(plane.address, [1, 1, 2, 3, 2, 1, 3])
    large = preset("desi", 1201)
    assert np.array_equal(np.bincount(large.bus), [500, 500, 201])
    assert large.address.min() == 1 and large.address.max() == 500


@pytest.mark.parametrize("name", ["paper", "desi", "desi_outlines", "moons"])
def test_no_part_of_a_robot_leaves_its_reach(name):
    plane = preset(name, 50)
    farthest = 0.0
    for seed in range(20):
        angles = np.random.default_rng(seed).uniform(-np.pi, np.pi, (plane.n, 2))
        angles[::5, 1] = 0.0  # stretched
        elbow = forward(plane, angles)[0] - plane.centers
        for origin, turn, vertices, radius in (
            (elbow, angles.sum(axis=1), plane.phi_vertices, plane.phi_radius),
            (0 * elbow, angles[:, 0], plane.theta_vertices, plane.theta_radius),
        ):
            c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
            x, y = np.moveaxis(vertices, -1, 0)
            x, y = origin[:, :1] + c * x - s * y, origin[:, 1:] + s * x + c * y
            far = np.hypot(x, y).max(axis=1, initial=0.0) + radius
            assert np.all(far <= plane.reach_mm + 1e-12)
            farthest = max(farthest, far.max())
    assert farthest > 0.98 * plane.reach_mm[0]  # and the bound is tight


def test_an_empty_plane_is_a_plane():
    plane = preset("desi", 1).permuted(np.zeros(0, dtype=int))
    assert plane.n == 0 and plane.reach_mm.shape == (0,)
    assert np.array_equal(plane.index_of([1]), [-1])
