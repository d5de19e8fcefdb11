# SPDX-License-Identifier: Apache-2.0
"""The results of a study: summaries of each case, as a table, as CSV and as JSON."""

import csv
import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from fiber_positioners.study.cases import Case, Row

__all__ = ["FIGURES", "RowFile", "Spread", "Summary", "save_study", "study_table", "summarize"]

# name -> (heading, digits): the figures that a study reports
FIGURES = {
    "reached_percent": ("reached %", 1),
    "makespan_s": ("makespan s", 2),
    "makespan_ratio": ("makespan / bound", 3),
    "segments_mean": ("segments a motor", 2),
    "bytes_mean": ("bytes a robot", 1),
}


@dataclass(frozen=True)
class Spread:
    """Mean, least and greatest value of a figure over several draws, and the standard deviation.

    The mean of few draws may be that of one with a robot that stretches the motion of all others:
    the deviation of the draws tells whether two cases differ.
    """

    mean: float
    least: float
    greatest: float
    deviation: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "Spread":
        """Return the spread of one or more values."""
        deviation = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
        return cls(float(np.mean(values)), min(values), max(values), deviation)

    def text(self, digits: int) -> str:
        """Return "mean +- deviation (least..greatest)", the mean alone of equal draws."""
        mean, least, greatest, deviation = (
            f"{value:.{digits}f}"
            for value in (self.mean, self.least, self.greatest, self.deviation)
        )
        return mean if least == greatest else f"{mean} +- {deviation} ({least}..{greatest})"


@dataclass(frozen=True)
class Summary:
    """The results of one case over its draws.

    Args:
        case: the case.
        fields: number of fields that were carried out.
        impossible: number of fields that could not be drawn.
        figures: the spread of each figure in FIGURES; without those that no field has.
        draws: the value of each figure in every field that was carried out.
        certified: whether every motion was certified.
    """

    case: Case
    fields: int
    impossible: int
    figures: dict[str, Spread]
    draws: dict[str, list[float]]
    certified: bool

    @classmethod
    def of(cls, case: Case, rows: Sequence[Row]) -> "Summary":
        """Sum up the rows of a case."""
        done = [row for row in rows if not row["error"]]
        figures, draws = {}, {}
        for name in FIGURES:
            values = [value for row in done if (value := _figure(row, name)) is not None]
            if values:
                figures[name], draws[name] = Spread.of(values), values
        certified = all(row["certified"] for row in done)
        return cls(case, len(done), len(rows) - len(done), figures, draws, certified)


def _figure(row: Row, name: str) -> float | None:
    if name == "reached_percent":
        asked, reached = row["asked"], row["reached"]
        assert isinstance(asked, int) and isinstance(reached, int)
        return 100.0 * reached / asked if asked else None
    value = row[name]
    return float(value) if isinstance(value, int | float) else None


def summarize(done: Iterable[tuple[Case, Row]]) -> list[Summary]:
    """Return a summary for each case, in the order in which the cases first appear."""
    rows: dict[Case, list[Row]] = {}
    for case, row in done:
        rows.setdefault(case, []).append(row)
    return [Summary.of(case, of_case) for case, of_case in rows.items()]


def study_table(summaries: Sequence[Summary]) -> str:
    """Return the summaries as lines of text: one row for each case, spreads in brackets."""
    cells = [["case", "fields", *(heading for heading, _ in FIGURES.values())]]
    for each in summaries:
        total = each.fields + each.impossible
        fields = f"{each.fields} of {total}" if each.impossible else str(total)
        spreads = [
            each.figures[name].text(digits) if name in each.figures else "-"
            for name, (_, digits) in FIGURES.items()
        ]
        cells.append([str(each.case), fields, *spreads])
    widths = [max(map(len, column)) for column in zip(*cells)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths)).rstrip() for row in cells
    )


class RowFile:
    """A CSV file of finished rows; each row is on the disk as soon as it is added.

    Args:
        path: the file, which is begun anew.
    """

    def __init__(self, path: Path):
        self._file = open(path, "w", newline="", encoding="utf-8")
        self._writer: csv.DictWriter[str] | None = None

    def __enter__(self) -> "RowFile":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, row: Row) -> None:
        """Append a row."""
        if self._writer is None:
            self._writer = csv.DictWriter(self._file, list(row))
            self._writer.writeheader()
        self._writer.writerow(row)
        self._file.flush()


def save_study(path: Path, done: Sequence[tuple[Case, Row]]) -> None:
    """Write the summaries of all cases and the rows of all fields as JSON."""
    summaries = [
        {
            **each.case.columns(),
            "fields": each.fields,
            "impossible": each.impossible,
            "certified": each.certified,
            **{name: asdict(spread) for name, spread in each.figures.items()},
        }
        for each in summarize(done)
    ]
    text = json.dumps({"cases": summaries, "rows": [row for _, row in done]}, indent=1)
    path.write_text(text + "\n", encoding="utf-8")
