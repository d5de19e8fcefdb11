# SPDX-License-Identifier: Apache-2.0
"""The minimum-link path against references without windows or hulls."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from fiber_discretizer import linearize

# Coarse corridors of which every path can be tried: whole times, angles in units of STEP.
STEP, PARTS, ROWS = 1.0, 4, 17


def coarse_corridor(seed):
    """A random corridor on whole numbers: times, profile, bounds."""
    rng = np.random.default_rng(seed)
    samples = int(rng.integers(3, 9))
    low = rng.integers(0, ROWS - 2, samples)
    high = low + rng.integers(1, 7, samples)
    for k in range(1, samples):  # neighbouring gates overlap
        low[k] = min(low[k], high[k - 1] - 1)
        high[k] = min(max(high[k], low[k - 1] + 1, low[k] + 1), ROWS - 1)
    profile = rng.integers(low, high + 1)
    low[[0, -1]] = high[[0, -1]] = profile[[0, -1]]
    return np.arange(samples, dtype=float), profile * STEP, low * STEP, high * STEP


@njit
def links_on_grid(low, high, steepest):
    """Fewest lines of a path inside the corridor with its breaks on a grid, by trying all.

    Breadth first: every break reached with k lines tries every grid point after it.
    """
    gates = len(low)
    times = (gates - 1) * PARTS + 1
    rows = 2 * ROWS
    lower, upper = np.empty(times), np.empty(times)
    for k in range(times):
        gate, part = k // PARTS, (k % PARTS) / PARTS
        after = min(gate + 1, gates - 1)
        lower[k] = (1 - part) * low[gate] + part * low[after]
        upper[k] = (1 - part) * high[gate] + part * high[after]
    links = np.full((times, rows), -1)
    links[0, int(round(2 * low[0]))] = 0
    for link in range(1, gates):
        for k in range(times):
            for y in range(rows):
                if links[k, y] != link - 1:
                    continue
                for m in range(k + 1, times):
                    for z in range(rows):
                        if links[m, z] >= 0:
                            continue
                        slope = 0.5 * (z - y) / (m - k)
                        inside = abs(slope) * PARTS <= steepest
                        for n in range(k, m + 1):
                            angle = 0.5 * y + slope * (n - k)
                            inside &= lower[n] - 1e-9 <= angle <= upper[n] + 1e-9
                        if inside:
                            links[m, z] = link
        end = links[times - 1, int(round(2 * low[-1]))]
        if end >= 0:
            return end
    return gates - 1


@njit
def links_by_windows(low, high):
    """Fewest lines by the definition of a window, every line through two corners tried.

    From a point or a window, the lines through any two corners of the corridor, window ends
    included, are followed as far as they stay inside; the one that gets farthest carries
    the next window, from where it touches the other bound last to where it leaves.
    """
    gates = len(low)
    x, y = np.empty(2 * gates + 2), np.empty(2 * gates + 2)
    for k in range(gates):
        x[k], y[k], x[gates + k], y[gates + k] = k, low[k], k, high[k]
    b_x = c_x = 0.0
    b_y = c_y = low[0]
    for link in range(1, gates + 1):
        x[-2], y[-2], x[-1], y[-1] = b_x, b_y, c_x, c_y
        farthest, best_b, best_slope, best_at, best_value = -1.0, 0.0, 0.0, 0.0, 0.0
        for p in range(len(x)):
            for q in range(len(x)):
                if x[q] <= x[p] + 1e-12:
                    continue
                slope = (y[q] - y[p]) / (x[q] - x[p])
                # it must cross the window, from one side to the other or touching it
                at_b = y[p] + slope * (b_x - x[p]) - b_y
                at_c = y[p] + slope * (c_x - x[p]) - c_y
                if at_b * at_c > 1e-18 and min(abs(at_b), abs(at_c)) > 1e-9:
                    continue
                cross = c_x
                if abs(at_b - at_c) > 1e-12:
                    cross = b_x + (c_x - b_x) * min(max(at_b / (at_b - at_c), 0.0), 1.0)
                stop, touch, on_low, on_high = cross, cross, cross, cross
                k = int(np.floor(cross + 1e-12)) + 1
                while k < gates:
                    angle = y[p] + slope * (k - x[p])
                    if low[k] - 1e-9 <= angle <= high[k] + 1e-9:
                        stop = float(k)
                        if abs(angle - low[k]) < 1e-9:
                            on_low = stop
                        if abs(angle - high[k]) < 1e-9:
                            on_high = stop
                        k += 1
                        continue
                    bound = low if angle < low[k] else high
                    before = y[p] + slope * (k - 1 - x[p]) - bound[k - 1]
                    after = angle - bound[k]
                    leaves = k - 1 + before / (before - after)
                    stop = max(stop, leaves)
                    touch = on_high if angle < low[k] else on_low
                    break
                if stop > farthest + 1e-12:
                    farthest, best_b, best_slope = stop, touch, slope
                    best_at, best_value = x[p], y[p]
                end = y[p] + slope * (gates - 1 - x[p])
                if stop >= gates - 1 and abs(end - low[-1]) < 1e-9:
                    return link
        b_x, c_x = best_b, farthest
        b_y = best_value + best_slope * (b_x - best_at)
        c_y = best_value + best_slope * (c_x - best_at)
    return gates


def links_of(corridor, method="minimal", speed=np.inf):
    time_s, profile, low, high = corridor
    path = linearize(time_s, profile[None], low[None], high[None], method, speed, [len(low) - 1])
    return int(path.counts[0])


def test_never_more_lines_than_any_path_with_its_breaks_on_a_grid():
    decided = 0
    for seed in range(1500):
        corridor = coarse_corridor(seed)
        _, _, low, high = corridor
        lines = links_of(corridor)
        most = links_on_grid(low, high, np.inf)
        assert lines <= most
        decided += lines == most
    assert decided > 1000  # the grid is fine enough to meet the minimum of most corridors


def test_as_few_lines_as_a_search_over_all_lines_through_two_corners():
    for seed in range(4000):
        corridor = coarse_corridor(seed)
        lines, reference = links_of(corridor), links_by_windows(*corridor[2:])
        assert lines == reference, f"seed {seed}: {lines} lines, {reference} would do"


@pytest.mark.parametrize("speed", [2.0, 4.0, 8.0])
def test_with_a_speed_limit_as_few_lines_as_any_path_on_a_grid(speed):
    decided = 0
    for seed in range(600):
        time_s, profile, low, high = corridor = coarse_corridor(seed)
        if np.abs(np.diff(profile)).max() > speed:
            continue
        lines = links_of(corridor, speed=speed)
        most = links_on_grid(low, high, speed)
        assert 1 <= lines <= most
        decided += lines == most
    assert decided > 25


@given(st.integers(0, 2**32 - 1))
def test_relaxed_paths_have_as_few_lines_and_use_less_of_the_corridor(seed):
    time_s, profile, low, high = corridor = coarse_corridor(seed)
    last = [len(low) - 1]
    used = []
    for method in ("minimal", "relaxed"):
        path = linearize(time_s, profile[None], low[None], high[None], method, np.inf, last)
        at = np.union1d(time_s, path.time_s)  # a path uses most of its corridor at one of these
        center, lower, upper = (np.interp(at, time_s, values) for values in (profile, low, high))
        way = path(at)[0] - center
        width = np.where(way < 0, center - lower, upper - center)
        wide = width > 1e-6
        used.append(np.max(np.abs(way)[wide] / width[wide], initial=0.0))
        assert path.counts[0] == links_of(corridor)
    assert used[1] <= used[0] + 1 / 32 + 1e-6


def test_a_corridor_too_fast_to_follow_has_no_path():
    time_s = np.arange(4.0)
    profile = np.array([[0.0, 0.0, 9.0, 9.0]])
    for speed, knots in ((8.0, 0), (9.1, 4)):
        path = linearize(time_s, profile, profile - 0.1, profile + 0.1, "minimal", speed, [3])
        assert len(path.time_s) == knots


def test_breaks_need_not_be_at_samples():
    # A corner between two samples: two lines are enough, and only off the samples.
    time_s = np.arange(6.0)
    corner = np.abs(time_s - 2.5)
    path = linearize(time_s, corner[None], corner[None], corner[None], "greedy")
    assert path.counts[0] == 3
    low = corner - np.where(np.isin(time_s, [2.0, 3.0]), 1.0, 0.0)
    path = linearize(time_s, corner[None], low[None], corner[None])
    assert path.counts[0] == 2 and path.time_s[1] == pytest.approx(2.5, abs=1e-6)


def test_corridors_of_no_width_and_corridors_that_open_late():
    time_s = np.arange(50.0)
    rng = np.random.default_rng(0)
    profile = np.cumsum(rng.normal(size=50))
    exact = linearize(time_s, profile[None], profile[None], profile[None])
    assert exact.counts[0] == 49
    np.testing.assert_allclose(exact(time_s)[0], profile, rtol=0, atol=1e-8)
    opening = np.where(time_s < 30, 0.0, 100.0)
    late = linearize(time_s, profile[None], (profile - opening)[None], (profile + opening)[None])
    assert late.counts[0] in (29, 30)


def test_noise_inside_the_corridor_costs_no_line():
    time_s = np.linspace(0.0, 1.0, 200)
    rng = np.random.default_rng(1)
    profile = 0.7 * time_s + 0.01 * rng.choice([-1.0, 1.0], 200)
    profile[[0, -1]] = 0.0, 0.7
    path = linearize(time_s, profile[None], profile[None] - 0.01, profile[None] + 0.01)
    assert path.counts[0] == 1
