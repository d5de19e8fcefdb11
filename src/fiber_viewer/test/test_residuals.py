# SPDX-License-Identifier: Apache-2.0
"""The figure of residuals: a vector for each fibre that an image shows, and its length counted."""

import numpy as np
import pytest
from matplotlib.quiver import Quiver

from fiber_core.outcomes import Outcome
from fiber_core.presets import preset
from fiber_recording import save_recording
from fiber_recording.errors import RecordingError
from fiber_recording.examples import seen_by_a_camera
from fiber_viewer import figures, residuals
from fiber_viewer.figures import command


def test_each_image_has_its_vectors_and_its_histogram(tmp_path):
    plane, rng = preset("desi", 40), np.random.default_rng(1)
    targets = plane.centers + [2.0, 0.0]
    targets[0] = np.nan  # no target
    images = [targets + size * rng.normal(size=targets.shape) for size in (0.04, 0.004)]
    images[1][1] = np.nan  # not seen
    figure = residuals(plane, targets, images, flagged=plane.ids[[2, 3]])
    panels = np.array(figure.axes).reshape(2, 2)
    for number, shown in ((0, 37), (1, 36)):
        (vectors,) = (each for each in panels[0, number].collections if isinstance(each, Quiver))
        assert len(vectors.U) == shown
        assert sum(bar.get_height() for bar in panels[1, number].patches) == shown
        assert f"{shown} fibres" in panels[0, number].get_title()
    # vectors of both images are drawn alike, though one is ten times as small
    longest = [
        np.percentile(np.hypot(v.U, v.V), 95)
        for v in (
            next(c for c in panels[0, k].collections if isinstance(c, Quiver)) for k in (0, 1)
        )
    ]
    np.testing.assert_allclose(longest, 1.5 * plane.arms.sum(axis=1).max(), rtol=1e-6)
    assert "2 robots did not move: 2, 3" in figure.get_suptitle()
    figure.savefig(tmp_path / "residuals.png")


def test_an_image_of_nothing_is_drawn_too():
    plane = preset("desi", 7)
    nothing = np.full((7, 2), np.nan)
    assert "0 fibres" in residuals(plane, nothing, [nothing]).axes[0].get_title()


def test_the_figure_of_a_recording_leaves_out_robots_that_were_held_or_did_not_move(recording):
    seen = seen_by_a_camera(recording, 1)  # those are 1.5 mm from their targets
    figure = figures.images(seen)
    panels = np.array(figure.axes).reshape(2, 2)
    place, targets = seen.images.place_mm, seen.problem.targets
    shown = np.isfinite(place + targets).all(axis=2) & (seen.outcome == Outcome.REACHED)
    shown[:, 4] = False
    um = [1e3 * np.hypot(*(each - targets)[rows].T) for each, rows in zip(place, shown)]
    assert max(lengths.max() for lengths in um) < 500.0
    for number, lengths in enumerate(um):
        rms = np.sqrt(np.mean(lengths**2))
        assert f"{len(lengths)} fibres, {rms:.1f} um rms" in panels[0, number].get_title()
        edges = [bar.get_x() for bar in panels[1, number].patches]
        counted, _ = np.histogram(np.minimum(lengths, np.percentile(lengths, 99)), 40)
        assert max(edges) < np.percentile(lengths, 99) and len(edges) == 40
        assert sum(bar.get_height() for bar in panels[1, number].patches) == counted.sum()
    assert "1 robots did not move: " in figure.get_suptitle()


def test_one_fibre_far_away_does_not_hide_the_histogram_of_the_others():
    plane, rng = preset("desi", 400), np.random.default_rng(1)
    places = plane.centers + 0.005 * rng.normal(size=(400, 2))
    places[7] += 6.0
    axes = residuals(plane, plane.centers, [places]).axes[1]
    heights = [bar.get_height() for bar in axes.patches]
    assert sum(heights) == 400 and np.count_nonzero(heights) > 20 and heights[-1] >= 4
    assert axes.get_xlim()[1] < 50.0


def test_the_command_draws_images_where_there_are_some(recording, recording_file, tmp_path, capsys):
    save_recording(tmp_path / "seen.npz", seen_by_a_camera(recording, 1))
    for path, drawn in ((tmp_path / "seen.npz", True), (recording_file, False)):
        out = tmp_path / str(drawn)
        assert command.main([str(path), "-o", str(out), "--formats", "png"]) == 0
        assert (out / "images.png").exists() == drawn and (out / "buses.png").exists()
    assert command.main([str(recording_file), "--only", "images", "-o", str(tmp_path)]) == 1
    assert "no camera has seen this plan" in capsys.readouterr().err
    with pytest.raises(RecordingError, match="no camera"):
        figures.images(recording)
