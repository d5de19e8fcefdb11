# SPDX-License-Identifier: Apache-2.0
"""The figure of residuals: a vector for each fibre that an image shows, and its length counted."""

import numpy as np
from matplotlib.quiver import Quiver

from fiber_core.presets import preset
from fiber_viewer import residuals


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
