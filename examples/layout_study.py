# SPDX-License-Identifier: Apache-2.0
"""A layout study: how close may robots stand, and how long may their arms be?

Run it with `python examples/layout_study.py`; ROBOTS=37 and SEEDS=1 make it smaller. The command
`fiber-positioners study` does the same from the command line.
"""

import os
from pathlib import Path

from fiber_positioners.study import grid, save_figure, study_rows, study_table, summarize

cases = grid(
    robots=[int(os.environ.get("ROBOTS", "200"))],
    pitch_mm=[7.5, 8.5, 9.5, 10.5],
    arms_mm=[(3.0, 3.0), (3.5, 3.5)],
)
seeds = range(1, 1 + int(os.environ.get("SEEDS", "3")))
done = []
for case, row in study_rows(cases, seeds):
    done.append((case, row))
    print(f"{len(done)} of {len(cases) * len(seeds)}: {case}, seed {row['seed']}")
summaries = summarize(done)
print(study_table(summaries))

folder = Path(os.environ.get("OUT", "out/layout_study"))
folder.mkdir(parents=True, exist_ok=True)
save_figure(folder / "study.png", summaries)
print("picture:", folder / "study.png")
