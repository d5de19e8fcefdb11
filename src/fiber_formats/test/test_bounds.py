# SPDX-License-Identifier: Apache-2.0
"""A layout file with an absurd value is refused with its robot, or read and usable."""

import subprocess
import sys

import pytest

_DRAWN = """
import sys
import numpy as np
from fiber_core import FiberError, assign, forward
from fiber_formats import read_layout

heads = ["id", "x_mm", "y_mm", "arm_theta_mm", "arm_phi_mm", "radius_mm", "theta_range_deg",
         "phi_range_deg", "theta_speed_deg_s", "phi_speed_deg_s", "bus", "address"]
usual = [0, 0, 0, 3, 3, 1, 380, 180, 170, 170, 0, 1]
column, path = heads.index(sys.argv[1]), sys.argv[2]
for value in ("0", "-1", "nan", "inf", "1e-300", "1e12", "1e25", "9223372036854775808", "1e5"):
    rows = [[str(u) for u in usual] for _ in range(3)]
    for k, row in enumerate(rows):
        row[0], row[1], row[-1] = str(k), str(12 * k), str(k + 1)
    rows[2][column] = value
    with open(path, "w") as file:
        file.write("\\n".join(",".join(row) for row in [heads, *rows]) + "\\n")
    try:
        plane = read_layout(path).plane
        start = np.zeros((3, 2))
        assign(plane, start, plane.ids, forward(plane, start + 0.5)[1])
    except FiberError as error:
        assert path in str(error), error
print("done")
"""


@pytest.mark.parametrize(
    "column",
    "id x_mm y_mm arm_theta_mm arm_phi_mm radius_mm theta_range_deg phi_range_deg "
    "theta_speed_deg_s phi_speed_deg_s bus address".split(),
)
def test_an_absurd_value_of_a_column_is_refused_or_works(column, tmp_path):
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", _DRAWN, column, str(tmp_path / "layout.csv")],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert run.stdout == "done\n", run.stderr[-2000:]
