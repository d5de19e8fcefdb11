# SPDX-License-Identifier: Apache-2.0
"""A whole instrument from tables: robots, fixed discs and targets.

Run it with `python examples/layout_from_csv.py`. The tables beside it are made up; the columns
that a layout may have are listed in src/fiber_formats/README.md.
"""

from pathlib import Path

import numpy as np

from fiber_positioners import (
    Problem,
    Reason,
    random_problem,
    read_layout,
    reconfigure,
    with_targets,
)

here = Path(__file__).parent
plane = read_layout(here / "layout.csv", preset="desi", obstacles=here / "fiducials.csv")
print(f"{plane.n} robots, {plane.enabled.sum()} enabled, {len(plane.obstacles)} fixed discs")
print(f"theta arms of {plane.arms[:, 0].min():.2f} to {plane.arms[:, 0].max():.2f} mm")

# The robots stand folded, each at the middle of its theta range.
start = np.stack([plane.limits[:, 0].mean(axis=1), plane.limits[:, 1, 1] - 0.1], axis=1)
problem = Problem(plane, start, np.full((plane.n, 2), np.nan))
first = reconfigure(with_targets(problem, here / "targets.csv"))
print(f"targets.csv: {first.report['reached']} of {first.report['asked']} reached")
for row in np.flatnonzero(~np.isin(first.reason, (Reason.OK, Reason.NO_TARGET))):
    print(f"  robot {plane.ids[row]}: {Reason(first.reason[row]).name.lower()}")

# The next targets are random ones, from where the robots are now.
second = reconfigure(random_problem(plane, seed=1, start=first.motion.end))
print(f"random targets: {second.report['reached']} of {second.report['asked']} reached")
