# SPDX-License-Identifier: Apache-2.0
"""An instrument of your own in 20 lines: 300 robots with arms of 3.5 and 3 mm, 3 % disabled.

Run it with `python examples/own_instrument.py`; ROBOTS=61 makes it smaller, OUT=folder moves files.
"""

import os

from fiber_positioners import hexagonal, random_problem, reconfigure

plane = hexagonal(
    robots=int(os.environ.get("ROBOTS", "300")),
    pitch_mm=10.0,
    arms_mm=(3.5, 3.0),
    radius_mm=0.9,
    limits_deg=((-190.0, 190.0), (0.0, 175.0)),
    speeds_deg_s=(160.0, 200.0),
    disabled=0.03,
    name="my instrument",
)
result = reconfigure(random_problem(plane, seed=1))
report = result.report
print(f"{report['reached']} of {report['asked']} robots reached their targets")
print(f"in {report['makespan_s']:.2f} s; no motion is shorter than {report['lower_bound_s']:.2f} s")
folder = result.save(os.environ.get("OUT", "out/own_instrument"))
print("open in a browser:", result.player(folder / "player.html"))
