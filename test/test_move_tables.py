# SPDX-License-Identifier: Apache-2.0
"""Real move tables: figures of a made-up table by hand, and of the real ones where they are."""

import importlib
import os
from pathlib import Path

import numpy as np
import pytest

NAMES = "posid,motor_steps_P,motor_steps_T,speed_mode_P,speed_mode_T,move_time,postpause"
# M1: theta 9000 steps in creep (1 s), a pause of 0.5 s, then phi 18000 steps in cruise (1.0453 s)
# M2: phi and theta 18000 steps in creep (2 s)
STEPS = (
    """M1,"[0, 18000]","[9000, 0]","['creep', 'cruise']","['creep', 'creep']",""",
    """M2,"[-18000]","[18000]","['creep']","['creep']",""",
)
TIMES = ('"[1.0, 1.0453]","[500, 0]"', '"[2.0]","[0]"')
LINES = tuple(steps + times for steps, times in zip(STEPS, TIMES))


@pytest.fixture(scope="module")
def tables():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[1] / "bench")
        return importlib.import_module("move_tables")


def _written(tmp_path, *lines: str) -> Path:
    path = tmp_path / "table.csv"
    path.write_text("\n".join([NAMES, *lines]) + "\n")
    return path


def test_the_figures_of_a_small_table(tables, tmp_path):
    runs = tables.read_runs(_written(tmp_path, *LINES))
    assert runs.positioners == 2
    assert runs.total_s == pytest.approx(2.5453)
    assert runs.motor_s == pytest.approx(1.0 + 1.0453 + 4.0)
    assert runs.peak == 0.75
    assert runs.share_on(np.array([0.5, 1.2, 1.7, 2.2])).tolist() == [0.75, 0.5, 0.75, 0.25]
    assert runs.bound_s(0.5) == pytest.approx(6.0453 / 2.0)


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("[2.0]", "[2.1]", "positioner M2 row 0 takes 2.1 s, its speeds say 2.0"),
        ("['creep']\",\"['creep']", "['creep']\",\"['sprint']", "M2 has the mode 'sprint'"),
        ("[2.0]", "[2.0, 1.0]", "M2 has lists of"),
    ],
)
def test_a_table_that_is_not_understood_is_refused(tables, tmp_path, old, new, words):
    path = _written(tmp_path, LINES[0], LINES[1].replace(old, new))
    with pytest.raises(tables.TableError, match=words):
        tables.read_runs(path)


def test_a_plan_is_a_table_of_its_true_curves(tables, tmp_path):
    # one robot: theta 0.1 s up, 1 s at 2 rad/s, 0.1 s down; phi 0.5 s at 0.1 rad/s, 1 s later
    np.savez(
        path := tmp_path / "plan.npz",
        curve_offsets=[0, 4, 7],
        curve_time_s=[0.0, 0.1, 1.1, 1.2, 0.0, 1.0, 1.5],
        curve_velocity_rad_s=[0.0, 2.0, 2.0, 0.0, 0.0, 0.1, 0.0],
        curve_acceleration_rad_s2=[20.0, 0.0, -20.0, 0.0, 0.0, 0.0, 0.0],
    )
    runs = tables.read_plan(path)
    assert (runs.positioners, runs.total_s, runs.peak) == (1, 1.5, 1.0)
    assert runs.motor_s == pytest.approx(1.7)
    assert runs.share_on(np.array([0.05, 1.05, 1.3])).tolist() == [0.5, 1.0, 0.5]
    assert (runs.end_s - runs.begin_s)[runs.creeps].sum() == pytest.approx(0.1 + 0.5)
    np.savez(path, offsets=[0])
    with pytest.raises(tables.TableError, match="plan.npz is no plan with true curves"):
        tables.read_plan(path)


def test_the_command_prints_a_line_a_table_and_draws(tables, tmp_path, capsys):
    path = _written(tmp_path, *LINES)
    assert tables.main([str(path), "--figure", str(tmp_path / "on.png")]) == 0
    assert "| table | 2 | 2.55 | 6 | 83% | 75% | 59% | 2.75 |" in capsys.readouterr().out
    assert (tmp_path / "on.png").stat().st_size > 1000


def test_the_real_tables_keep_their_cap(tables):
    default = Path(__file__).resolve().parents[1].parent / "shared" / "data"
    folder = Path(os.environ.get("FIBER_DATA", default)) / "desi"
    paths = sorted(folder.glob("hwtables_*.csv"))
    if not paths:
        pytest.skip(f"no move tables in {folder}; set FIBER_DATA")
    for path in paths:
        runs = tables.read_runs(path)
        assert 0.5 < runs.peak < 0.56
        assert runs.bound_s(0.55) < runs.total_s
