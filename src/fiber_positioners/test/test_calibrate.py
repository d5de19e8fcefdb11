# SPDX-License-Identifier: Apache-2.0
"""The command `calibrate`: points out, measured places in, a plane out that every command reads."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from fiber_bus_bridge.simulation import (
    MechanicalErrors,
    arms_at,
    arms_motion,
    draw_mechanics,
    true_angles,
)
from fiber_core import kinematics
from fiber_core.motion import SegmentMotion
from fiber_formats import read_layout, write_layout
from fiber_positioners.command import main

N = 19


class Instrument:
    """True arms apart from what the layout says, and a camera."""

    def __init__(self, folder, seed=0):
        self.folder, self.rng = folder, np.random.default_rng(seed)
        self.layout = folder / "plane.csv"
        x, y = np.meshgrid(np.arange(N) * 11.0, [0.0])
        with open(self.layout, "w", newline="") as file:
            rows = [("id", "x_mm", "y_mm", "preset")]
            rows += [(100 + k, x[0, k], y[0, k], "desi") for k in range(N)]
            csv.writer(file).writerows(rows)
        self.plane = read_layout(self.layout).plane
        errors = MechanicalErrors(scale=0.005, backlash_deg=0.3)
        drawn = draw_mechanics(N, errors, self.rng)
        scale = drawn.scale.copy()
        scale[3, 1], scale[4, 0] = 0.7, 0.0
        self.zeros = np.deg2rad(self.rng.uniform(-3.0, 3.0, (N, 2)))
        self.mechanics = drawn.with_(scale=scale)
        self.true = replace(self.plane, arms=self.plane.arms + self.rng.normal(0.0, 0.03, (N, 2)))

    def history(self, path, points, left_out=()):
        """Go to the points, and write what a camera sees."""
        with open(points, newline="") as file:
            rows = list(csv.DictReader(file))
        shape = (len(rows) // N, N)
        counters = np.deg2rad([[float(r["theta_deg"]), float(r["phi_deg"])] for r in rows])
        counters = counters.reshape(*shape, 2)
        state = arms_at(self.mechanics, counters[0] + self.zeros)
        places = [np.full((N, 2), np.nan)]
        for before, after in zip(counters, counters[1:]):
            way = (after - before).ravel()
            lasts = np.maximum(np.abs(way), 1e-12)
            motion = SegmentMotion(before, np.arange(2 * N + 1), lasts, way / lasts)
            _, state = arms_motion(self.mechanics, state, motion)
            tips = kinematics.forward(self.true, true_angles(self.mechanics, state))[1]
            places.append(tips + self.rng.normal(0.0, 2.5e-3, (N, 2)))
        for row, place in zip(rows, np.concatenate(places)):
            row["x_mm"], row["y_mm"] = (
                ("", "") if np.isnan(place[0]) else map(repr, map(float, place))
            )
        rows = [row for k, row in enumerate(rows) if k not in left_out]
        with open(path, "w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            writer.writerows(rows)


@pytest.fixture(scope="module")
def instrument(tmp_path_factory):
    made = Instrument(tmp_path_factory.mktemp("instrument"))
    made.points = made.folder / "points.csv"
    assert (
        main(["calibrate", "--layout", str(made.layout), "--points", "20", str(made.points)]) == 0
    )
    return made


def calibrated(instrument, name, *more):
    history = instrument.folder / f"history_{name}.csv"
    instrument.history(history, instrument.points)
    target = instrument.folder / f"{name}.csv"
    arguments = ["--layout", str(instrument.layout), "--history", str(history), str(target)]
    assert main(["calibrate", *arguments, *more]) == 0
    return target


def test_the_table_is_a_plane_with_measured_arms_scales_and_backlash(instrument, capsys):
    target = calibrated(instrument, "first", "--error-um", "2.5")
    told = capsys.readouterr().out
    assert f"20 points, {N} robots: {N - 2} good, 1 linear, 1 stuck" in told
    assert "robot 104: stuck" in told
    plane = read_layout(target).plane
    sound = np.arange(N) != 4
    off = np.abs(plane.arms - instrument.true.arms)[sound]
    assert off.max() < 0.01
    assert np.array_equal(plane.arms[4], instrument.plane.arms[4])
    scale = instrument.mechanics.scale
    assert np.abs(plane.drive.scale - scale)[sound].max() < 5e-3
    assert np.array_equal(plane.drive.scale[4], np.ones((2, 2)))
    lost = np.rad2deg(plane.drive.lost_motion_rad)[sound]
    assert np.abs(lost - np.rad2deg(instrument.mechanics.backlash_rad)[sound]).max() < 0.2


def test_zeros_are_in_the_ranges_of_the_plane_and_come_back_from_its_table(instrument):
    target = calibrated(instrument, "zeros", "--error-um", "2.5")
    plane, before = read_layout(target).plane, instrument.plane.limits
    sound = np.arange(N) != 4
    zeros = instrument.zeros[sound]
    # theta turns as a whole; phi does not get a second elbow by it
    turned = (plane.limits - before)[sound]
    assert np.abs(turned[:, 0] - zeros[:, :1]).max() < np.deg2rad(0.4)
    low = np.maximum(zeros[:, 1], 0.0), np.minimum(before[sound, 1, 1] + zeros[:, 1], np.pi)
    assert np.abs(plane.limits[sound, 1].T - low).max() < np.deg2rad(0.4)
    assert (plane.limits[:, 1, 0] >= 0.0).all() and (plane.limits[:, 1, 1] <= np.pi).all()
    np.testing.assert_allclose(plane.limits[4], before[4], atol=1e-12)
    # the fit tells the same zeros, and a table of it read and written again is the same plane
    with open(target.with_name("zeros_fit.csv"), newline="") as file:
        told = np.deg2rad([float(row["theta_zero_deg"]) for row in csv.DictReader(file)])
    np.testing.assert_allclose(turned[:, 0, 0], told[sound], atol=1e-9)
    again = instrument.folder / "again.csv"
    assert main(["convert", str(target), str(again)]) == 0
    for name in ("centers", "arms", "limits"):
        np.testing.assert_allclose(getattr(read_layout(again).plane, name), getattr(plane, name))


def test_a_table_with_zeros_and_ranges_gets_stops_in_their_place(instrument):
    layout = instrument.folder / "with_zeros.csv"
    with open(instrument.layout, newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row |= {"theta_zero_deg": "20", "theta_range_deg": "380", "phi_range_deg": "178"}
    with open(layout, "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    found = read_layout(layout)
    moved = found.plane.limits + 0.01
    target = instrument.folder / "moved.csv"
    ends = {
        f"{joint}_{end}_deg": np.rad2deg(moved[:, j, k])
        for j, joint in enumerate(("theta", "phi"))
        for k, end in enumerate(("min", "max"))
    }
    write_layout(target, found, ends)
    with open(target, newline="") as file:
        names = next(csv.reader(file))
    assert not [name for name in names if "zero" in name or "range" in name]
    np.testing.assert_allclose(read_layout(target).plane.limits, moved, atol=1e-12)


def test_a_robot_that_drifts_over_nights_is_named_alone(instrument, capsys):
    fits = []
    arms = instrument.true.arms
    for night in range(6):
        drifted = arms.copy()
        drifted[7, 1] += 0.01 * night
        instrument.true = replace(instrument.true, arms=drifted)
        calibrated(instrument, f"night{night}", "--error-um", "2.5")
        fits.append(str(instrument.folder / f"night{night}_fit.csv"))
    capsys.readouterr()
    target = instrument.folder / "trend.csv"
    assert main(["calibrate", "--nights", ",".join(fits), str(target)]) == 0
    assert f"6 nights, {N} robots: 1 drift\nrobot 107 drifts" in capsys.readouterr().out
    with open(target, newline="") as file:
        row = list(csv.DictReader(file))[7]
    assert row["drifts"] == "arm_phi_mm"
    slope, error = (float(row[f"{p}arm_phi_mm_a_night"]) for p in ("", "error_of_"))
    assert abs(slope - 0.01) < 5.0 * error
    figure, nights = instrument.folder / "trend.png", ["calibrate", "--nights", ",".join(fits)]
    assert main([*nights, "--figure", str(figure), str(target)]) == 0
    assert "1 robots are drawn" in capsys.readouterr().out and figure.stat().st_size > 10_000
    more = ["--figure", str(figure.with_suffix(".pdf")), "--robots", "107,103"]
    assert main([*nights, *more, str(target)]) == 0
    assert "2 robots are drawn" in capsys.readouterr().out
    for wrong, why in ((["--figure", "trend.svg"], "as .pdf or .png"), (
        ["--figure", str(figure), "--robots", "99"], "robot 99 is in no table"
    )):  # fmt: skip
        assert main([*nights, *wrong, str(target)]) == 2
        assert why in capsys.readouterr().err


def test_histories_that_lack_a_point_or_name_another_robot_are_refused(instrument, capsys):
    history, target = instrument.folder / "bad.csv", instrument.folder / "out.csv"
    arguments = ["--layout", str(instrument.layout), "--history", str(history), str(target)]
    instrument.history(history, instrument.points, left_out=(5 * N + 2,))
    assert main(["calibrate", *arguments]) == 2
    assert "robot 102 has point 5 0 times, expected once" in capsys.readouterr().err
    text = history.read_text().replace("\n3,104,", "\n3,999,", 1)
    history.write_text(text)
    assert main(["calibrate", *arguments]) == 2
    assert "robot 999 is not of this plane" in capsys.readouterr().err
    assert main(["calibrate", "--history", str(history), str(target)]) == 2
    assert "--layout names the plane" in capsys.readouterr().err
    assert not target.exists()


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--poins", "20"], "unknown option --poins, similar is --points"),
        ([], "one of --history, --points and --nights is missing"),
        (["--points", "20"], "--layout names the plane, and is missing"),
        (["--nights", "a.csv", "--layout", "b.csv"], "no effect with --nights"),
        (["--history", "a.csv", "--layout", "b.csv", "--seed", "1"], "--seed has no effect"),
    ],
)
def test_options_that_are_unknown_missing_or_without_effect_are_named(options, named, capsys):
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(main(["calibrate", *options, "out.csv"]))
    assert ended.value.code == 2 and named in capsys.readouterr().err
