# SPDX-License-Identifier: Apache-2.0
"""A study carries out each case of its grid with several draws and reports their spread."""

import numpy as np
import pytest

from fiber_core.errors import FiberError
from fiber_core.presets import preset
from fiber_positioners import random_problem, reconfigure
from fiber_positioners.study import (
    Case,
    Spread,
    grid,
    study_figure,
    study_rows,
    study_table,
    summarize,
)


def row(**values):
    nothing = {"asked": 10, "reached": 10, "makespan_ratio": 1.0, "segments_mean": 1.0}
    nothing |= {"makespan_s": 2.0}
    return nothing | {"bytes_mean": 10.0, "certified": True, "error": ""} | values


def test_a_grid_has_a_case_for_every_combination():
    cases = grid(pitch_mm=[10.0, 11.0], disabled=[0.0, 0.1], planner=["direct", "dnf"])
    assert len(cases) == 8 and len(set(cases)) == 8
    assert [case.pitch_mm for case in cases] == [10.0] * 4 + [11.0] * 4
    assert [case.planner for case in cases[:2]] == ["direct", "dnf"]


def test_a_case_without_figures_of_its_own_is_the_preset():
    case = Case(preset="desi", robots=19)
    plane, same = case.plane(np.random.default_rng(1)), preset("desi", 19)
    assert np.array_equal(plane.centers, same.centers) and np.array_equal(plane.arms, same.arms)
    report = reconfigure(random_problem(same, 4), seed=4).report
    carried_out = case.run(4)
    for name in ("reached", "makespan_s", "segments_mean", "bytes_mean"):
        assert carried_out[name] == report[name]


def test_a_plane_with_walls_and_scatter_is_no_case():
    with pytest.raises(FiberError, match="preset desi_petals is no plain grid"):
        Case(preset="desi_petals").check()


def test_figures_of_a_case_replace_those_of_the_preset():
    case = Case(robots=7, pitch_mm=12.0, arms_mm=(3.0, 2.5), radius_mm=0.8)
    plane = case.plane(np.random.default_rng(1))
    nearest = np.linalg.norm(plane.centers[1:] - plane.centers[0], axis=1).min()
    assert nearest == pytest.approx(12.0)
    assert plane.arms.tolist() == [[3.0, 2.5]] * 7 and (plane.phi_radius == 0.8).all()
    assert plane.phi_vertices[0, -1].tolist() == [2.5, 0.0]


def test_the_share_of_disabled_robots_is_drawn_with_the_seed():
    case = Case(robots=400, disabled=0.25)
    first, same, other = (case.plane(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first.enabled, same.enabled)
    assert not np.array_equal(first.enabled, other.enabled)
    assert 60 <= (~first.enabled).sum() <= 140


def test_targets_of_narrow_arms_may_be_closer_than_those_of_the_preset():
    # the targets of the preset are 4 mm apart, which 2000 robots with a pitch of 4.4 mm are not
    narrow = Case(robots=200, pitch_mm=4.4, arms_mm=(1.8, 1.8), radius_mm=0.5)
    assert narrow.plane(np.random.default_rng(1)).envelope_mm == 2.0
    assert narrow.run(1)["reached"] == 200


def test_a_field_that_cannot_be_drawn_is_a_row_with_an_error():
    case = Case(robots=61, pitch_mm=0.5)
    carried_out = case.run(1)
    assert "found no" in str(carried_out["error"]) and carried_out["reached"] is None
    (summary,) = summarize([(case, carried_out)])
    assert (summary.fields, summary.impossible, summary.figures) == (0, 1, {})
    assert "0 of 1" in study_table([summary])


@pytest.mark.parametrize(
    ("case", "said"),
    [
        (Case(preset="desy"), "desy"),
        (Case(pitch_mm=0.0), "pitch must be positive, got 0 mm"),
        (Case(arms_mm=(3.0, -1.0)), "phi arm must be positive, got -1 mm"),
        (Case(radius_mm=float("nan")), "radius must be positive, got nan mm"),
        (Case(robots=0), "robots must be a positive integer, got 0"),
        (Case(disabled=1.0), "got 1"),
    ],
)
def test_an_impossible_figure_is_refused_with_its_value(case, said):
    with pytest.raises(FiberError, match=said):
        case.check()


def test_rows_come_as_soon_as_each_field_is_done():
    rows = study_rows(grid(robots=[7, 10**9]), seeds=[1])
    case, carried_out = next(rows)
    assert case.robots == 7 and carried_out["reached"] == 7


def test_a_summary_has_mean_least_and_greatest_of_its_draws():
    case = Case()
    done = [
        (case, row(reached=9, makespan_ratio=1.0)),
        (case, row(reached=10, makespan_ratio=1.2)),
        (case, row(error="a robot found no start", reached=None)),
    ]
    (summary,) = summarize(done)
    assert summary.figures["reached_percent"] == Spread(95.0, 90.0, 100.0, pytest.approx(50**0.5))
    assert summary.figures["makespan_ratio"].text(2) == "1.10 +- 0.14 (1.00..1.20)"
    assert summary.figures["bytes_mean"].text(1) == "10.0"
    assert (summary.fields, summary.impossible) == (2, 1) and summary.certified


def test_a_motion_without_certificate_shows_in_the_summary():
    (summary,) = summarize([(Case(), row()), (Case(), row(certified=False))])
    assert not summary.certified


def test_the_picture_has_a_line_for_each_other_parameter():
    done = [
        (case, row(seed=1, segments_mean=case.pitch_mm))
        for case in grid(pitch_mm=[9.0, 10.0, 11.0], radius_mm=[0.8, 1.0])
    ]
    figure = study_figure(summarize(done))
    assert [axes.get_title() for axes in figure.axes[:5]] == [
        "reached %", "makespan s", "makespan / bound", "segments a motor", "bytes a robot",
    ]  # fmt: skip
    assert not any(axes.axison for axes in figure.axes[5:])
    for axes in figure.axes[:5]:
        assert axes.get_xlabel() == "pitch [mm]" and len(axes.containers) == 2
    x, y = figure.axes[3].containers[0][0].get_data()
    assert list(x) == list(y) == [9.0, 10.0, 11.0]
    assert {c.get_label() for c in figure.axes[0].containers} == {"radius_mm 0.8", "radius_mm 1.0"}


def test_the_picture_has_a_dot_for_every_draw():
    case = Case()
    draws = [1.0, 1.1, 2.7]  # one robot stretches the motion of all others
    figure = study_figure(summarize([(case, row(makespan_ratio=ratio)) for ratio in draws]))
    dots = figure.axes[2].lines[-1]
    assert dots.get_marker() == "." and sorted(dots.get_ydata()) == draws
