# SPDX-License-Identifier: Apache-2.0
"""The figure of calibrated numbers over nights shows what was given, and a line where it drifts."""

import numpy as np

from fiber_viewer.figures import trends

NAMES = tuple(f"number {k}" for k in range(12))


def test_numbers_are_drawn_about_their_mean_with_a_line_for_each_that_drifts():
    rng, nights = np.random.default_rng(2), 6
    numbers = 5.0 + rng.normal(0.0, 0.1, (nights, 2, 12))
    numbers[:, 1, 7] += 0.5 * np.arange(nights)
    numbers[2, 0, 3] = np.nan
    drifts = np.zeros((2, 12), dtype=bool)
    drifts[1, 7] = True
    figure = trends(
        NAMES, np.array([3, 8]), numbers, np.full_like(numbers, 0.1), np.full((2, 12), 0.5), drifts
    )
    axes = figure.axes
    assert [each.get_title() for each in axes] == list(NAMES)
    lines = [len(each.get_lines()) for each in axes]
    assert lines[7] == 3 and lines.count(2) == 11
    drawn = axes[3].get_lines()[0].get_ydata()
    np.testing.assert_allclose(drawn, numbers[:, 0, 3] - np.nanmean(numbers[:, 0, 3]))
    slope = np.diff(axes[7].get_lines()[2].get_ydata())
    np.testing.assert_allclose(slope, 0.5)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["robot 3", "robot 8"]


def test_no_robots_make_a_figure_that_says_so():
    none = np.zeros((5, 0, 12))
    figure = trends(NAMES, np.zeros(0, int), none, none, none[0], none[0] > 0)
    assert figure.get_suptitle() == "no robot drifts" and not figure.legends
