# SPDX-License-Identifier: Apache-2.0
"""Results as a confSummary of SDSS-V, read back by the readers of starts and targets."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_core.kinematics import fibre_places
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_formats import (
    FormatError,
    check_results,
    read_layout,
    read_starts,
    read_targets,
    write_results,
)
from fiber_formats.fibre_map import is_fibre_map

_COLUMNS = (
    "positionerId", "fiberType", "assigned", "on_target", "valid", "decollided", "xwok", "ywok",
    "alpha", "beta",
)  # fmt: skip


@pytest.fixture
def plan(made_up):
    """A plane with fibres, outcomes of its robots, angles, and the targets of all but the last."""
    names = ("positionerTable", "wokCoords", "fiducialCoords", "gfaCoords")
    plane = read_layout([made_up / f"sdss_{name}.csv" for name in names]).plane
    low, high = np.moveaxis(plane.limits, -1, 0)
    angles = low + np.random.default_rng(1).uniform(0.1, 0.9, (plane.n, 2)) * (high - low)
    science = [plane.fibre_names.index(name) for name in ("BOSS", "APOGEE")]
    rows = np.arange(plane.n)
    targets = fibre_places(plane, angles)[rows, np.take(science, rows % 2)]
    targets[-1] = np.nan
    outcome = np.full(plane.n, int(Outcome.REACHED))
    reason = np.zeros(plane.n, dtype=np.int64)
    outcome[[1, 2, -1]] = Outcome.HELD, Outcome.FAILED, Outcome.HELD
    reason[[1, 2, -1]] = Reason.NOT_CONVERGED, Reason.OFF_TARGET, Reason.NO_TARGET
    error_mm = np.where(np.isnan(targets[:, 0]), np.nan, 0.0)
    return plane, PlanOutcome(1, plane.ids, outcome, reason, error_mm), angles, targets


def _write(path, plan):
    plane, outcome, angles, targets = plan
    return write_results(path, plane, outcome, angles, "sdss_v", targets)


@pytest.mark.parametrize("name", ["night.par", "night.par.gz"])
def test_a_confsummary_gives_angles_and_reached_places_back(plan, tmp_path, name):
    plane, _, angles, targets = plan
    path = tmp_path / name
    written = _write(path, plan)
    starts, found = read_starts(path, plane), read_targets(path, plane)
    assert np.allclose(starts.angles, angles, rtol=0, atol=1e-12)
    rows = plane.index_of(found.ids)
    asked = np.flatnonzero(~np.isnan(targets[:, 0]))
    assert np.array_equal(np.sort(rows), asked) and found.without_target.tolist() == [plane.ids[-1]]
    assert found.xy_mm.tolist() == written.reached_mm[rows].tolist()
    assert found.fibre.tolist() == written.fibre[rows].tolist()
    assert not [path for path in tmp_path.iterdir() if path.name != name]


def test_each_robot_has_a_row_for_each_fibre_and_one_of_them_is_on_the_target(plan, tmp_path):
    plane, _, angles, _ = plan
    _write(tmp_path / "night.par", plan)
    text = (tmp_path / "night.par").read_text()
    rows = [line.split()[1:] for line in text.splitlines() if line.startswith("FIBERMAP ")]
    of = {name: np.array(values) for name, values in zip(_COLUMNS, zip(*rows, strict=True))}
    assert of["positionerId"].astype(int).tolist() == np.repeat(plane.ids, 3).tolist()
    assert of["fiberType"].tolist() == list(plane.fibre_names) * plane.n
    places = np.stack([of["xwok"], of["ywok"]], axis=1).astype(float)
    assert np.array_equal(places.reshape(plane.n, 3, 2), fibre_places(plane, angles))
    per_robot = {
        name: of[name].astype(int).reshape(plane.n, 3)
        for name in ("assigned", "on_target", "valid", "decollided")
    }
    assert per_robot["assigned"].sum(axis=1).tolist() == [1] * (plane.n - 1) + [0]
    reached = [0 if k in (1, 2, plane.n - 1) else 1 for k in range(plane.n)]
    assert per_robot["on_target"].sum(axis=1).tolist() == reached
    assert (per_robot["on_target"] <= per_robot["assigned"]).all()
    assert (per_robot["valid"] == (np.arange(plane.n) != 2)[:, None]).all()
    assert (per_robot["decollided"] == (np.arange(plane.n) == 1)[:, None]).all()


def test_what_no_confsummary_can_hold_is_refused(plan, tmp_path):
    plane, outcome, angles, targets = plan
    path = tmp_path / "night.par"
    other = replace(plane, fibre_names=("APOGEE", "BOSS", "SKY"))
    with pytest.raises(FormatError, match="the plane has APOGEE, BOSS, SKY"):
        _write(path, (other, outcome, angles, targets))
    bare = replace(plane, fibres=None, fibre_names=None, fibre=None)
    with pytest.raises(FormatError, match="the plane has none"):
        _write(path, (bare, outcome, angles, targets))
    tips = fibre_places(plane, angles)[:, plane.fibre_names.index("METROLOGY")]
    with pytest.raises(FormatError, match=f"robot {plane.ids[0]} is for the fibre METROLOGY"):
        _write(path, (plane, outcome, angles, tips))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("form", [None, "desi", "pfs"])
def test_a_yanny_file_is_of_one_form_only_and_refused_before_the_work(form):
    with pytest.raises(FormatError, match=rf"night\.par: a .par is .* the form is {form}"):
        check_results("night.par", form)
    check_results("night.ecsv", form)
    check_results("night.PAR", "sdss_v")


def test_suffixes():
    assert is_fibre_map("a.par") and is_fibre_map("a.b.par.gz")
    assert not is_fibre_map("a.par.csv") and not is_fibre_map("par.gz")
    with pytest.raises(FormatError, match="a table is written as"):
        check_results("night.paw", "sdss_v")
    with pytest.raises(FormatError, match="no form is named 'keck'"):
        check_results("night.csv", "keck")
