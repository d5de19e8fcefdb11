#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Make the page docs/paper.md: what the two papers print, beside what runs give.

The runs repeat the figures of Makarem et al. (A&A 566, A84, and SPIE, arXiv 1410.1181) on random
fields of the plane of the papers. --quick makes the same page of few robots, for tests.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from paper_runs import (
    SIZES,
    THEOREM,
    Row,
    bus_times,
    discretizations,
    laws,
    swarm,
    three_robots,
)

from fiber_viewer import figures

__all__ = ["main"]

_ROOT = Path(__file__).parents[1]
_DPI = 80
_QUICK_SIZES = (7, 19)

_PAGE = """# The two papers, printed and repeated

Made by `make paper` from runs on random fields of the plane `paper` (pitch 12 mm, which the
papers do not print; arms 3 + 3 mm, D = 4 mm, d = 2 mm, 180 and 120 deg/s). *Printed* is what A&A
566, A84 (2014) and arXiv 1410.1181 (2014) say; all other figures are of the runs of this page.
Times of computing are processor times of one core of {machine}. The errata and their
corrections: [navigation function](dnf.md), [discretizer](discretizer.md).

| printed | run | holds |
|---|---|---|
{claims}

The laws: *as printed* (the sign of the repulsion too), *sign corrected* (and nothing else),
`dnf` (all corrections), `dnf_priority` (with priorities for robots that block each other, and
without rehearsals), and `direct`, which looks ahead and is not of the papers.

## Motion time against the number of robots

Printed: all robots arrive, the motion lasts 2.65 to 2.7 s from 1000 robots on (2.5 s in the
abstract). *Bound*: the slowest robot alone. "-": fewer robots arrive. Medians over the fields of
a size.

![motion time]({images}/paper-motion-time.png)

{motion}

## Convergence

Printed: 4100 runs of 7 to 5167 robots, all converge. Shares of the robots within 0.1 mm of their
targets, on the first field of {largest} robots:

![convergence]({images}/paper-convergence.png)

What each correction does, on a field of {law_robots} robots; below a tip distance of
2 mm two ferrules have collided:

{laws}

The condition of theorem 1, lambda1 < 0.048 lambda2, is not met by the papers' own weights
(lambda1 = 20 lambda2). With a weight that meets it, 0.04, {slow} of the robots arrive within the
horizon, three times the time of the slowest robot alone.

## Computing time against the number of robots

Printed: 140 s for 5000 robots, in proportion to their number.

![computing time]({images}/paper-computing-time.png)

## A conflict of three robots

Printed: three robots of which the first gives way, the second passes and the third passes both,
in six snapshots, with at most 3 segments a profile. Below are three robots in a row, 8 mm apart,
of which the middle one has to pass between its neighbours; theta turns once and phi half a turn.
Robots of three that arrive: {arrive}. The figures are of `dnf_priority`, discretized by our
method (the seven steps of the second paper let {seven_steps} of 3 go), sent to simulated robots,
and drawn from the bytes: {reached_of_three} of 3 are there after {three_s} s, where the slowest
alone would need {three_bound_s} s, with a least gap of {three_gap_mm} mm. Segments of theta and
phi: {three_segments}.

![six moments]({images}/paper-conflict.png)

![velocities]({images}/paper-velocities.png)

![positions]({images}/paper-positions.png)

## Segments and bits

Printed: at most 3 segments in the conflict of three; no statistics, no bits. The seven steps
with half of the distance of the tips as the share of each robot (*as printed*), with half of
what is free beyond the gap that must remain (*safe*), and our own method; {robots_d} robots. A
profile is the motion of one motor; the least is one segment.

{segments}

## Time on the bus

Printed: "Fast plus I2C", up to 3.4 Mbit/s, which mixes two modes; no time. From the first LOAD
to GO, each order verified, {bus_robots} robots with orders of `direct`:

{bus}
"""


def _table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [list(heads), ["---"] * len(heads), *[[str(cell) for cell in row] for row in rows]]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _seconds(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "-"


def _share(row: Row) -> str:
    return "100 %" if row["reached"] == row["asked"] else f"{_percent(row):.2f} %"


def _percent(row: Row) -> float:
    return 100.0 * row["reached"] / row["asked"]


def _motion_table(rows: list[Row]) -> str:
    heads = ["robots", "fields", "law", "arrive", "90 / 99 % there [s]", "last there [s]",
             "bound [s]", "computing [s]"]  # fmt: skip
    return _table(
        heads,
        [
            [row["robots"], row["fields"], row["law"], _share(row),
             f"{_seconds(row['t90_s'])} / {_seconds(row['t99_s'])}", _seconds(row["last_s"]),
             _seconds(row["bound_s"]), f"{row['cpu_s']:.3g}"]
            for row in rows
        ],
    )  # fmt: skip


def _laws_table(rows: list[Row]) -> str:
    heads = ["law", "arrive", "least tip distance [mm]", "pairs of arms that overlap"]
    return _table(
        heads,
        [[r["law"], _share(r), f"{r['least_tip_mm']:.2f}", r["overlapping_pairs"]] for r in rows],
    )


def _segments_table(rows: list[Row]) -> str:
    heads = ["planner", "seven steps or ours", "segments a profile: mean", "most theta / phi",
             "bits a profile", "bytes an order", "held", "certified"]  # fmt: skip
    names = {"makarem2014 as printed": "as printed", "makarem2014": "safe"}
    return _table(
        heads,
        [
            [r["planner"], names.get(r["way"], "ours"), f"{r['mean']:.3f}",
             f"{r['theta_max']} / {r['phi_max']}", f"{r['bits']:.1f}", r["bytes_mean"], r["held"],
             "yes" if r["certified"] else "no"]
            for r in rows
        ],
    )  # fmt: skip


def _bus_table(rows: list[Row]) -> str:
    heads = ["buses x robots", "clock", "bytes an order", "to GO [ms]", "least [ms]", "reached"]
    return _table(
        heads,
        [
            [r["topology"], r["clock"], f"{r['bytes']:.2f}", f"{r['to GO ms']:.1f}",
             f"{r['bound ms']:.1f}", r["reached"]]
            for r in rows
        ],
    )  # fmt: skip


def _claims(
    rows: list[Row], law_rows: list[Row], three: Row, segments: list[Row], bus: list[Row]
) -> str:
    # the printed claims, each with the run that decides it
    largest = rows[-1]["robots"]
    of = {row["law"]: row for row in rows if row["robots"] == largest}
    law = {row["law"]: row for row in law_rows}
    printed, fixed, priority = (of[k] for k in ("as printed", "sign corrected", "dnf_priority"))
    fine, fast = law["sign corrected, steps of 1 ms"], law["sign corrected"]
    steps = [r for r in segments if r["way"] == "makarem2014"]
    return "\n".join(
        f"| {claim} | {run} | {holds} |"
        for claim, run, holds in (
            ("all robots converge", f"{largest} robots: {_share(printed)} with the law as printed, "
             f"{_share(fixed)} with its sign corrected, {_share(of['dnf'])} with `dnf`, "
             f"{_share(priority)} with `dnf_priority`",
             _yes(printed["reached"] == printed["asked"])),
            ("the motion lasts 2.65 to 2.7 s from 1000 robots on",
             f"{largest} robots: 90 % are there after {_seconds(printed['t90_s'])} s; "
             f"`dnf_priority` ends after {_seconds(priority['last_s'])} s, `direct` after "
             f"{_seconds(of['direct']['last_s'])} s; bound {_seconds(priority['bound_s'])} s",
             _yes(np.isfinite(printed["t99_s"]) and printed["last_s"] <= 2.7)),
            ("no two tips collide (2 mm)", f"{law['as printed']['least_tip_mm']:.2f} mm printed; "
             f"sign corrected {fast['least_tip_mm']:.2f} mm with steps of 10 ms, "
             f"{fine['least_tip_mm']:.2f} mm with 1 ms; `dnf`, which shortens its steps: "
             f"{law['dnf']['least_tip_mm']:.2f} mm",
             _yes(law["as printed"]["least_tip_mm"] >= 2.0)),
            ("140 s of computing for 5000 robots", f"{largest} robots: {printed['cpu_s']:.3g} s",
             f"{140.0 / printed['cpu_s']:.2g} times as fast"),
            ("three robots in conflict pass each other, with at most 3 segments",
             f"as printed {three['arrive']['as printed']} of 3 arrive, with priorities "
             f"{three['reached']}, with at most {max(map(max, three['segments']))} segments",
             _yes(three["arrive"]["as printed"] == 3)),
            ("few segments a profile (no figure)", "; ".join(
                f"`{r['planner']}`: {r['mean']:.2f}, at most {max(r['theta_max'], r['phi_max'])}"
                for r in steps), "not comparable"),
            ("orders reach 5000 robots in time (no figure)", "; ".join(
                f"{r['topology']} at {r['clock']}: {r['to GO ms']:.0f} ms, "
                f"{r['reached']} reached" for r in bus), "not comparable"),
        )
    )  # fmt: skip


def _yes(holds: bool) -> str:
    return "yes" if holds else "**no**"


def _curves(rows: list[Row]) -> dict[str, Figure]:
    # the figures against the number of robots, and the convergence of the largest plane
    names = list(dict.fromkeys(row["law"] for row in rows))
    drawn = {}
    for name, column, label in (
        ("motion-time", "last_s", "last arrival [s]"),
        ("computing-time", "cpu_s", "computing time [s]"),
    ):
        figure = Figure(figsize=(7, 4), layout="constrained")
        axes = figure.subplots()
        for law in names:
            of_law = [row for row in rows if row["law"] == law]
            axes.plot([r["robots"] for r in of_law], [r[column] for r in of_law], "o-", label=law)
        if column == "last_s":
            sizes = [row["robots"] for row in rows if row["law"] == names[0]]
            bounds = [row["bound_s"] for row in rows if row["law"] == names[0]]
            axes.plot(sizes, bounds, "k--", label="bound: the slowest robot alone")
            axes.axhline(2.7, color="grey", label="printed, from 1000 robots on: all arrive")
        else:
            axes.plot([5000], [140.0], "k*", ms=12, label="printed: 140 s")
            axes.set_yscale("log")
        axes.set(xscale="log", xlabel="robots", ylabel=label)
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
        drawn[name] = figure
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes = figure.subplots()
    for row in rows[-len(names) :]:
        share = 100.0 * np.arange(1, len(row["there_s"]) + 1) / len(row["there_s"])
        axes.step(row["there_s"], share, where="post", label=row["law"])
    axes.set(xlabel="time [s]", ylabel="robots at their targets [%]", ylim=(50, 101))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return drawn | {"convergence": figure}


def _write(out: Path, images: Path, quick: bool, machine: str) -> None:
    sizes = _QUICK_SIZES if quick else SIZES
    law_robots = 19 if quick else 547
    robots = 37 if quick else 1027
    rows = swarm(sizes, 1 if quick else None)
    law_rows = laws(law_robots)
    result, three = three_robots()
    planners = ("dnf_priority",) if quick else ("dnf", "dnf_priority", "direct")
    segments = discretizations(robots, planners)
    bus = bus_times(37 if quick else 5000)
    trio = np.arange(3)
    drawn = _curves(rows) | {
        "conflict": figures.conflict(result.recording, trio),
        "velocities": figures.velocities(result.recording, trio),
        "positions": figures.positions(result.recording, trio),
    }
    images.mkdir(parents=True, exist_ok=True)
    for name, figure in drawn.items():
        figure.savefig(images / f"paper-{name}.png", dpi=_DPI)
    text = _PAGE.format(
        machine=machine,
        claims=_claims(rows, law_rows, three, segments, bus),
        images=Path(os.path.relpath(images, out.parent)).as_posix(),
        motion=_motion_table(rows),
        largest=sizes[-1],
        law_robots=law_robots,
        laws=_laws_table(law_rows),
        slow=_share(next(row for row in law_rows if row["law"] == THEOREM)),
        arrive=", ".join(f"{law} {n}" for law, n in three["arrive"].items()),
        seven_steps=three["seven_steps"],
        reached_of_three=three["reached"],
        three_s=_seconds(three["makespan_s"]),
        three_bound_s=_seconds(three["bound_s"]),
        three_gap_mm=_seconds(three["least_gap_mm"]),
        three_segments=", ".join(f"{theta} and {phi}" for theta, phi in three["segments"]),
        robots_d=robots,
        segments=_segments_table(segments),
        bus_robots=37 if quick else 5000,
        bus=_bus_table(bus),
    )
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(text, encoding="utf-8")


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="few robots, to test the page")
    parser.add_argument("--machine", default="a shared 2-core machine", help="for the page")
    parser.add_argument("--out", type=Path, default=_ROOT / "docs/paper.md", help="the page")
    parser.add_argument("--images", type=Path, default=_ROOT / "docs/images", help="folder")
    options = parser.parse_args(argv)
    _write(options.out, options.images, options.quick, options.machine)
    print(options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
