#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Plans for motors with ramps and uncertain joints, judged by a checker that shares no code.

Every field is planned, sent over simulated buses and saved; `drive_checker` then reads the files.

    python3 bench/drive.py --fields 20 --out bench/results/drive.md
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from drive_checker import Verdict, check

from fiber_core.drive.named import with_drive
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets import preset
from fiber_planner.direct.parameters import DirectParameters
from fiber_planner.direct.planner import DirectPlanner
from fiber_positioners import Reconfiguration, random_problem, reconfigure


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Args:
        title: the work.
        preset: instrument.
        drive: one of fiber_core.DRIVES.
        robots: their number; by default that of the instrument.
        radius_mm: half width of the arms in place of that of the preset [mm].
        errors: random errors of all joints for each field that the checker tries.
        shortening: effort of the planner to shorten its first plan, see DirectParameters.
    """

    title: str
    preset: str
    drive: str
    robots: int | None = None
    radius_mm: float | None = None
    errors: int = 0
    shortening: float = DirectParameters.shortening

    def plane(self) -> FocalPlane:
        """The focal plane of the row."""
        plane = preset(self.preset, self.robots)
        if self.radius_mm is not None:
            plane = replace(plane, phi_radius=np.full(plane.n, self.radius_mm))
        return with_drive(plane, self.drive)


ROWS = {
    "accelerated": Row("DESI-like 5000, 2000 deg/s2", "desi", "accelerated", 5000),
    "sdss_v": Row(
        "SDSS-V 547, half width 1.5 mm, joints uncertain by 1.5 deg; first plan, not shortened",
        "sdss_v",
        "sdss_v",
        radius_mm=1.5,
        errors=1000,
        shortening=0.0,
    ),
}
COLUMNS = (
    "work", "fields", "reached", "makespan / bound, median (largest)", "makespan [s], median",
    "bound [s], median", "segments per moving motor", "broken rules", "contacts",
    "contacts of true arms", "least gap [mm]", "least true gap [mm]", "curve error [rad]",
    "plan + discretize, processor time [s], median",
)  # fmt: skip
HEADER = f"| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|"


def one_field(row: Row, plane: FocalPlane, seed: int) -> tuple[Reconfiguration, Verdict]:
    """Plan one field and have its files judged."""
    planner = DirectPlanner(DirectParameters(shortening=row.shortening))
    result = reconfigure(random_problem(plane, seed=seed), planner=planner, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        result.save(folder, recording=False)
        files = Path(folder) / "problem.npz", Path(folder) / "plan.npz"
        # slow arms move 0.3 mm between two instants at most, fast ones 0.06 mm
        step_s = 2e-3 if plane.speeds.max() > 1.0 else 40e-3
        verdict = check(*files, step_s=step_s, errors=row.errors, seed=seed)
    return result, verdict


def line_of(row: Row, fields: Sequence[tuple[Reconfiguration, Verdict]]) -> str:
    """Return the line of the table."""
    reports = [result.report for result, _ in fields]
    verdicts = [verdict for _, verdict in fields]

    def total(name: str) -> int:
        return sum(int(str(report[name])) for report in reports)

    bounds = np.array([float(str(report["lower_bound_s"])) for report in reports])
    # the checker's makespan, which it finds in the orders
    makespans = np.array([verdict.makespan_s for verdict in verdicts])
    cpu = [sum(result.orders.cpu_seconds.values()) for result, _ in fields]
    ratio = makespans / bounds
    cells = (
        row.title,
        len(fields),
        f"{total('reached')} of {total('asked')}",
        f"{np.median(ratio):.4f} ({ratio.max():.4f})",
        f"{np.median(makespans):.3f}",
        f"{np.median(bounds):.3f}",
        f"{np.mean([float(str(report['segments_mean'])) for report in reports]):.3f}",
        sum(verdict.violations for verdict in verdicts),
        sum(verdict.contacts for verdict in verdicts),
        sum(verdict.true_contacts for verdict in verdicts),
        f"{min(verdict.least_gap_mm for verdict in verdicts):.4f}",
        f"{min(verdict.least_true_gap_mm for verdict in verdicts):.4f}",
        f"{max(verdict.curve_error_rad for verdict in verdicts):.1e}",
        f"{np.median(cpu):.1f}",
    )
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> int:
    """Run the rows and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rows", nargs="+", choices=sorted(ROWS), default=sorted(ROWS))
    parser.add_argument("--fields", type=int, default=20, help="fields of each row")
    parser.add_argument("--errors", type=int, help="errors for each field, in place of the row's")
    parser.add_argument("--out", type=Path, help="write the table here")
    args = parser.parse_args()
    lines = [HEADER]
    for name in args.rows:
        row = ROWS[name] if args.errors is None else replace(ROWS[name], errors=args.errors)
        plane, fields = row.plane(), []
        for seed in range(args.fields):
            begin = time.perf_counter()
            fields.append(one_field(row, plane, seed))
            wall = time.perf_counter() - begin
            print(f"{name} field {seed}: {fields[-1][1]} in {wall:.0f} s", file=sys.stderr)
            if args.out is not None:  # a long run that is ended leaves what it found
                table = [*lines, line_of(row, fields)]
                args.out.write_text("\n".join(table) + "\n", encoding="utf-8")
        lines.append(line_of(row, fields))
        print(lines[-1])
    return 0


if __name__ == "__main__":
    sys.exit(main())
