#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Draw an ordered line and the true curve that a motor with a ramp makes of it.

python3 bench/true_curve.py docs/images/true-curve.png
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from fiber_core.drive import Drive, carried_out
from fiber_core.motion import SegmentMotion

RAMP_S = 0.09
SEGMENTS = ((0.3, 90.0), (0.2, -60.0), (0.25, 30.0))  # durations [s], velocities [deg/s]


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the figure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("path", type=Path)
    path = parser.parse_args(arguments).path
    duration, velocity = np.array(SEGMENTS).T
    offsets = np.array([0, len(duration), len(duration)])
    ordered = SegmentMotion(np.zeros((1, 2)), offsets, duration, np.deg2rad(velocity))
    true = carried_out(Drive(1, ramp_s=RAMP_S), ordered)
    times = np.linspace(-0.05, true.makespan_s + 0.05, 2000)
    lines = (
        ("ordered", ordered, 0.0, "tab:gray"),
        ("ordered, half a ramp later", ordered, 0.5 * RAMP_S, "tab:blue"),
        ("true curve", true, 0.0, "tab:red"),
    )
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    above, below = figure.subplots(2, sharex=True)
    for label, motion, later, color in lines:
        style = {"label": label, "color": color, "lw": 1.2}
        angle = [motion(t - later)[0, 0] for t in times]
        above.plot(times, np.rad2deg(angle), **style)
        if later == 0.0:
            speed = [motion.velocity(t)[0, 0] for t in times]
            below.plot(times, np.rad2deg(speed), **style)
    above.set(ylabel="theta [deg]", title=f"A ramp of {1e3 * RAMP_S:.0f} ms")
    below.set(ylabel="velocity [deg/s]", xlabel="time [s]")
    above.legend(fontsize="small")
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
