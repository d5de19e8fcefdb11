# SPDX-License-Identifier: Apache-2.0
"""The table of the lines of `motors`: one row for each kind of work, with its goals."""

import numpy as np

__all__ = ["table_of"]

# work, least share of what ends allow [%], most makespan over bound, bound, most makespan [s],
# most segments, most processor time [s]
WORK = {
    "blind": ("DESI 2026, blind, at most 55 % of motors on", 99.5, 1.15, "power", None, None, 10.0),
    "without_cap": ("the same without the cap", 99.5, 1.1, "power", None, None, 10.0),
    "corrections": ("corrections of 50-500 um, 55 %", 99.5, None, "power", 5.0, None, 10.0),
    "accelerated": ("DESI-like 5000, 2000 deg/s2", 100.0, 1.03, "lower", None, 1.15, None),
    "uncertain": (
        "SDSS-V 547, half width 1.5 mm, ends off by 1.05 mm", 99.0, None, "lower", None, None,
        None,
    ),
}  # fmt: skip
_LINEAR_UM = 54.0
COLUMNS = (
    "work", "fields", "reached of what ends allow, all (least field)",
    "makespan / bound, median (most)", "makespan [s], median (most)",
    "bounds [s], median: alone, motor time over cap", "motors on, most", "segments",
    "bytes an order", "broken rules", "contacts", "near",
    "contacts of true arms in simulated moves", "least gap [mm]", "end error, most [um]",
    "plan + discretize, processor time [s], median (most)", "goals",
)  # fmt: skip


def table_of(lines: list[dict]) -> str:
    """Return the table of all lines, and that of linear robots."""
    rows = [_row(name, [x for x in lines if x["row"] == name]) for name in WORK]
    parts = [_of(COLUMNS, [row for row in rows if row])]
    if linear := [line for line in lines if line["row"] == "linear"]:
        parts.append(_linear(linear))
    return "\n".join(parts)


def _row(name: str, fields: list[dict]) -> list | None:
    if not fields:
        return None
    work, share, most_ratio, bound, most_s, most_segments, most_cpu_s = WORK[name]
    column = {key: np.array([field[key] for field in fields]) for key in fields[0]}
    reached = 100.0 * column["reached"] / column["reachable_at_once"]
    bounds = column[f"{bound}_bound_s"]
    ratio, makespan, cpu = column["makespan_s"] / bounds, column["makespan_s"], column["cpu_s"]
    segments = column["segments_mean"].astype(float)
    broken = int(column["violations"].sum() + column["drive_violations"].sum())
    contacts, true = int(column["contacts"].sum()), column.get("true_contacts")
    faults = broken + contacts + (0 if true is None else int(true.sum()))
    misses = [
        text
        for missed, text in (
            (reached.min() < share, f"share {share:g} %"),
            (most_ratio is not None and ratio.max() > most_ratio, f"ratio {most_ratio}"),
            (most_s is not None and makespan.max() > most_s, f"{most_s} s"),
            (most_segments is not None and segments.max() > most_segments, "segments"),
            (most_cpu_s is not None and cpu.max() > most_cpu_s, f"time {most_cpu_s} s"),
            (faults > 0 or not column["certified"].all(), "rules and contacts"),
        )
        if missed
    ]
    peak = column.get("peak")
    return [
        work,
        len(fields),
        f"{column['reached'].sum()} of {column['reachable_at_once'].sum()} ({reached.min():.2f} %)",
        f"{np.median(ratio):.4f} ({ratio.max():.4f})",
        f"{np.median(makespan):.3f} ({makespan.max():.3f})",
        f"{np.median(column['lower_bound_s']):.3f}, {np.median(column['supply_bound_s']):.3f}",
        "" if peak is None else f"{peak.max():.1%}",
        f"{segments.mean():.2f}",
        f"{column['bytes_mean'].astype(float).mean():.1f}",
        broken,
        contacts,
        int(column["near"].sum()),
        "" if true is None else f"{true.sum()} in {column['simulated_moves'].sum()}",
        f"{column['least_gap_mm'].min():.4f}",
        f"{column['end_error_um'].max():.2f}",
        f"{np.median(cpu):.1f} ({cpu.max():.1f})",
        "missed: " + ", ".join(misses) if misses else "hold",
    ]


def _linear(fields: list[dict]) -> str:
    parts = list(fields[0]["parts_um"])
    names = (
        "fields", "linear robots in use", "asked", "with orders", "draws of errors a field",
        "blind error of linear robots, rms [um] (single draws)",
        f"each kind alone [um]: {', '.join(parts)}", "others, rms [um]", "contacts of true arms",
        f"goal {_LINEAR_UM:g} um",
    )  # fmt: skip
    linear_um, others_um = (_pooled(fields, k) for k in ("linear_rms_um", "others_rms_um"))
    single = np.array([f["of_one_draw_um"] for f in fields])
    kinds = [_pooled([f["parts_um"] for f in fields], part) for part in parts]
    contacts = sum(field["contacts"] for field in fields)
    holds = linear_um <= _LINEAR_UM and contacts == 0
    cells = [
        len(fields),
        fields[0]["linear"],
        *(sum(field[key] for field in fields) for key in ("linear_asked", "linear_ordered")),
        fields[0]["draws"],
        f"{linear_um:.1f} ({single.min():.1f} to {single.max():.1f})",
        ", ".join(f"{kind:.1f}" for kind in kinds),
        f"{others_um:.1f}",
        contacts,
        "holds" if holds else "missed",
    ]
    return _of(names, [cells])


def _pooled(fields: list[dict], key: str) -> float:
    # rms over all fields, of about as many robots each
    return float(np.sqrt(np.mean(np.array([field[key] for field in fields]) ** 2)))


def _of(columns: tuple, rows: list[list]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)
