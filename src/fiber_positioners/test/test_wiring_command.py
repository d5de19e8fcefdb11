# SPDX-License-Identifier: Apache-2.0
"""The command `wiring`: turns out, lights in, swapped robots by name."""

import csv
import json

import numpy as np
import pytest

from fiber_core import kinematics
from fiber_core.fields import random_field
from fiber_formats import read_layout
from fiber_positioners.command import main

N = 37


@pytest.fixture(scope="module")
def night(tmp_path_factory):
    """A layout, and the lights of its robots, of which two pairs are swapped and one is dark."""
    folder, rng = tmp_path_factory.mktemp("wiring"), np.random.default_rng(3)
    layout, turns, lights = (folder / f"{name}.csv" for name in ("plane", "turns", "lights"))
    with open(layout, "w", newline="") as file:
        rows = [(100 + k, 10.4 * (k % 6), 10.4 * (k // 6), "desi") for k in range(N)]
        csv.writer(file).writerows([("id", "x_mm", "y_mm", "preset"), *rows])
    assert main(["wiring", "--layout", str(layout), str(turns)]) == 0
    plane = read_layout(layout).plane
    moves = np.arange(N)
    moves[[3, 4]], moves[[10, 30]] = (4, 3), (30, 10)
    start = random_field(plane, rng).problem.start
    with open(turns, newline="") as file:
        turned = np.array([float(row["phi_turn_deg"]) for row in csv.DictReader(file)])
    with open(lights, "w", newline="") as file:
        write = csv.writer(file)
        write.writerow(("image", "x_mm", "y_mm"))
        for image, each in enumerate(np.deg2rad(turned).reshape(-1, N)):
            arms = np.array(start)
            arms[moves, 1] += each
            tips = kinematics.forward(plane, arms)[1] + rng.normal(0.0, 4.5e-3, (N, 2))
            write.writerows([(image, *tip) for k, tip in enumerate(tips) if k != 20])
    return folder, layout, lights


def test_swapped_robots_are_named_and_written(night, capsys):
    folder, layout, lights = night
    target = folder / "wiring.csv"
    options = ["wiring", "--layout", str(layout), "--lights", str(lights), str(target)]
    assert main(options) == 0
    *named, counts = capsys.readouterr().out.splitlines()
    assert json.loads(counts) == {
        "in_place": N - 5, "swapped": 4, "not_seen": 1, "not_turned": 0,
        "ambiguous": 0, "reversed": 0,
        "other_joint": 0,
    }  # fmt: skip
    assert [line.split(":")[0] for line in named] == [
        f"robot {100 + k}" for k in (3, 4, 10, 20, 30)
    ]
    assert "at the place of robot 104: these two are swapped" in named[0]
    with open(target, newline="") as file:
        rows = list(csv.DictReader(file))
    assert [rows[k]["at_id"] for k in (0, 3, 4, 10, 20, 30)] == [
        "100",
        "104",
        "103",
        "130",
        "",
        "110",
    ]


def test_other_words_tell_nothing_and_bad_lights_are_refused(night, capsys):
    folder, layout, lights = night
    target = folder / "other.csv"
    options = ["wiring", "--layout", str(layout), "--lights", str(lights)]
    assert main([*options, "--seed", "1", str(target)]) == 0
    counts = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert counts["in_place"] == counts["swapped"] == 0
    bad = folder / "bad.csv"
    bad.write_text("image,x_mm,y_mm\n0,1.0,2.0\n32,1.0,2.0\n")
    assert main([*options[:3], "--lights", str(bad), str(target)]) == 2
    assert "is no image from 0 to 31" in capsys.readouterr().err
    assert main([*options[:3], "--margin-mm", "2", str(target)]) == 2
    assert "--margin-mm 2.0 is not above 0" in capsys.readouterr().err


def test_with_present_angles_no_turn_leads_out_of_the_range_of_phi(night):
    folder, layout, _ = night
    starts, turns = folder / "starts.csv", folder / "at_the_end.csv"
    plane = read_layout(layout).plane
    phi_deg = np.rad2deg(plane.limits[:, 1, 1])
    with open(starts, "w", newline="") as file:
        rows = [(robot, 0.0, end) for robot, end in zip(plane.ids, phi_deg)]
        csv.writer(file).writerows([("id", "theta_deg", "phi_deg"), *rows])
    options = ["wiring", "--layout", str(layout), "--starts", str(starts), str(turns)]
    assert main(options) == 0
    with open(turns, newline="") as file:
        turned = np.array([float(row["phi_turn_deg"]) for row in csv.DictReader(file)])
    assert (turned <= 1e-6).all() and (turned < -0.1).any()
