# SPDX-License-Identifier: Apache-2.0
"""Checked columns of one table: everything that is wrong is collected and refused at once."""

import difflib
import os
import re
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from fiber_core.array_types import Bools, Floats, Ids, Ints
from fiber_formats.errors import FormatError
from fiber_formats.source import Source
from fiber_formats.table import Column, Table, folded

__all__ = ["MOST_ID", "Columns", "near", "read_columns"]

MOST_ID = 2**32 - 1  # the wire carries 32 bits
_NAMED = 10  # how many rows a message lists
_NEARER = 0.9  # the same for a column that a table may lack
_NEAR = 0.8  # ratio of equal letters from which a name counts as a misspelt one
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$", re.ASCII)
_WHOLE = re.compile(r"([+-]?\d{1,99})(\.0*)?$", re.ASCII)  # Python refuses to convert thousands
_TRUE, _FALSE = ("true", "t", "yes", "y", "1", "1.0"), ("false", "f", "no", "n", "0", "0.0")


# names of flags that could mean either
_FLAG_NAMES = (
    *(
        "active",
        "alive",
        "available",
        "bad",
        "broken",
        "dead",
        "faulty",
        "good",
        "in_use",
        "masked",
    ),
    *("offline", "ok", "online", "operational", "state", "status", "stuck", "usable", "working"),
)


def read_columns(path: str | os.PathLike[str], *names: str) -> "Columns":
    """Return the columns of the table in a file that has some of them.

    Args:
        path: the file.
        names: columns that the table must have.

    Raises:
        FormatError: the file cannot be read, or has no such table.
    """
    return Columns(Source([path]).only.table_with(*names))


def near(name: str, known: Iterable[str]) -> str | None:
    """Return the known name of which another is probably a misspelling, None without one."""
    found = difflib.get_close_matches(folded(name), [folded(k) for k in known], 1, _NEAR)
    return found[0] if found else None


class Columns:
    """Read columns of a table as checked arrays, and refuse all that is wrong at once.

    A column that is missing or wrong gives an array of zeros or nan and is noted; `check` raises
    one error with all notes. `unused` lists the columns that were never asked for.

    Args:
        table: the table.
        keep: which rows are read, shape (rows,); by default all.
    """

    def __init__(self, table: Table, keep: Bools | None = None):
        self.table = table
        self._rows = np.arange(table.rows) if keep is None else np.flatnonzero(keep)
        self._asked: set[str] = set()
        self._lacking: list[str] = []
        self._absent: list[str] = []
        self._problems: list[str] = []
        self._ids: list[str] | None = None

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, name: str) -> bool:
        return name in self.table

    def every(self) -> "Columns":
        """The same table with all its rows; what it asks for counts as asked here too."""
        other = Columns(self.table)
        other._asked = self._asked
        return other

    @property
    def unused(self) -> list[str]:
        """Names of columns that were never asked for, as the file spells them."""
        return [c.name for key, c in self.table.columns.items() if key not in self._asked]

    def unused_notice(self) -> tuple[str, ...]:
        """Return a notice of the columns that were never asked for; empty without any."""
        names = self.unused + ["one without name"] * min(self.table.unnamed, 1)
        return (f"columns not used: {', '.join(names)}",) if names else ()

    def optional(self, name: str) -> bool:
        """Return whether there is a column that a table may lack; `absent_notice` names it if not.

        A column that is probably a misspelling of it is refused by `check`.
        """
        if name in self:
            return True
        if name not in self._absent:
            self._absent.append(name)
        return False

    def absent_notice(self) -> tuple[str, ...]:
        """Return a notice of the optional columns that are not there; empty without any."""
        if not self._absent:
            return ()
        return (
            f"columns that such a table can have, and this one has not: {', '.join(self._absent)}",
        )

    def flag_names(self) -> list[str]:
        """Return the columns never asked for that may tell which robots are in use."""
        return [name for name in self.unused if self._may_be_flags(name)]

    def _may_be_flags(self, name: str) -> bool:
        column = self.table.columns[folded(name)]
        if folded(name) in _FLAG_NAMES:
            return True
        if column.values.ndim != 1:
            return False
        words = {str(v).strip().lower() for v in column.values[self._rows][~column.missing]}
        numbers = {"0", "1", "0.0", "1.0"}
        return (
            bool(words) and words <= {*_TRUE, *_FALSE} and (not words <= numbers or len(words) > 1)
        )

    def check(self) -> None:
        """Raise what was noted.

        Raises:
            FormatError: columns are missing or values are refused; names all of them.
        """
        notes = list(self._problems)
        for name in self._absent:
            if meant := difflib.get_close_matches(
                folded(name), map(folded, self.unused), 1, _NEARER
            ):
                typo = self.table.columns[meant[0]].name
                notes.append(f"column {typo} is not known; is {name} meant?")
        if self._lacking:
            hints = [
                f"; is {self.table.columns[hint].name} meant as {name}?"
                for name in self._lacking
                if (hint := near(name, (folded(other) for other in self.unused)))
            ]
            notes.insert(
                0,
                f"no column {', '.join(self._lacking)}; it has {', '.join(self.table.names)}"
                + "".join(hints),
            )
        if notes:
            raise FormatError(f"{self.table.label}: " + "; ".join(notes))

    def note(self, problem: str) -> None:
        """Note a problem that `check` raises."""
        self._problems.append(problem)

    def ids(self, name: str) -> Ids:
        """Robot ids, whole numbers that the wire can carry, each once; shape (rows,)."""
        column = self._column(name)
        if column is None:
            return np.arange(len(self))
        before = len(self._problems)
        ids = self.whole(name, least=0, most=MOST_ID, what=f"is not a number from 0 to {MOST_ID}")
        if len(self._problems) == before:  # else rows are named by their lines
            self._ids = [str(value) for value in column.values[self._rows]]
        if not self._problems:
            order = np.argsort(ids, kind="stable")
            twice = np.flatnonzero(np.diff(ids[order]) == 0)
            if len(twice):
                self.note(f"more than one row for {self._named(order[twice + 1])}")
        return ids

    def numbers(self, name: str, unit: str | None = None, missing: bool = False) -> Floats:
        """Finite numbers of a column, nan where a value is missing; shape (rows,).

        Args:
            name: the column.
            unit: unit of the result; a column that has a unit of its own is converted.
            missing: whether values may be missing.
        """
        column = self._column(name)
        if column is None or not self._is_flat(column):
            return np.full(len(self), np.nan)
        absent = column.missing[self._rows]
        values, bad = _numbers(column.values[self._rows])
        values[absent] = np.nan
        bad = bad & ~absent if missing else bad | absent
        self._refuse(np.asarray(bad), column, "is not a number")
        return values * self._factor(column, unit)

    def whole(
        self,
        name: str,
        least: int = -(2**62),
        most: int = 2**62,
        what: str = "is not a whole number",
        otherwise: int | None = None,
    ) -> Ints:
        """Whole numbers of a column, exact to 62 bits; shape (rows,).

        Args:
            name: the column.
            least: least number allowed.
            most: greatest number allowed.
            what: what a message says of other values.
            otherwise: number for a missing value; without one a missing value is refused.
        """
        column = self._column(name)
        if column is None or not self._is_flat(column):
            return np.zeros(len(self), dtype=np.int64)
        absent = column.missing[self._rows]
        numbers = [_whole(value) for value in column.values[self._rows].tolist()]
        if column.values.dtype.str[1:] == "f4":  # larger numbers stand for several
            numbers = [n if n is not None and abs(n) < 2**24 else None for n in numbers]
        good = np.array([n is not None and least <= n <= most for n in numbers], dtype=bool)
        bad = ~good & ~absent if otherwise is not None else ~good | absent
        self._refuse(bad, column, what)
        fill = 0 if otherwise is None else otherwise
        return np.array(
            [n if ok and n is not None else fill for n, ok in zip(numbers, good & ~absent)],
            dtype=np.int64,
        ).reshape(len(self))

    def flags(self, name: str) -> Bools:
        """Truth of a column: true/false, T/F, yes/no or 1/0 in any case; shape (rows,)."""
        column = self._column(name)
        if column is None or not self._is_flat(column):
            return np.zeros(len(self), dtype=bool)
        words = np.array([str(v).strip().lower() for v in column.values[self._rows]], dtype=str)
        absent = column.missing[self._rows]
        yes, no = np.isin(words, _TRUE), np.isin(words, _FALSE)
        self._refuse(~(yes | no) | absent, column, "is neither true nor false")
        return yes & ~absent

    def words(self, name: str, missing: bool = False) -> NDArray[np.str_]:
        """Texts of a column, empty where missing; shape (rows,)."""
        column = self._column(name)
        if column is None or not self._is_flat(column):
            return np.full(len(self), "", dtype=str)
        absent = column.missing[self._rows]
        if not missing:
            self._refuse(absent, column, "is missing")
        texts = np.array([str(v).strip() for v in column.values[self._rows]], dtype=str)
        return np.where(absent, "", texts.reshape(len(self)))

    def vectors(self, name: str, size: int, unit: str | None = None) -> Floats:
        """Numbers of a column with several in a row, nan where missing; shape (rows, size)."""
        column = self._column(name)
        if column is None:
            return np.full((len(self), size), np.nan)
        values = column.values[self._rows]
        if values.dtype.kind not in "iuf" or values.shape[1:] != (size,):
            self.note(f"column {column.name} has {_shape(values)}, expected {size} numbers a row")
            return np.full((len(self), size), np.nan)
        result = values.astype(float)
        result[column.missing[self._rows]] = np.nan
        self._refuse(np.asarray(np.isinf(result).any(axis=1)), column, "is not a number")
        return result * self._factor(column, unit)

    def is_number(self, name: str) -> bool:
        """Return whether every value of a column is a whole number or missing."""
        column = self.table.columns.get(folded(name))
        if column is None or column.values.ndim != 1:
            return False
        return all(
            gone or _whole(value) is not None
            for value, gone in zip(column.values.tolist(), column.missing)
        )

    def holds_other_ids(self, name: str) -> bool:
        """Return whether a column has a different whole number in each row, and not its number."""
        if not self.is_number(name):
            return False
        numbers = [_whole(value) for value in self.table.columns[folded(name)].values.tolist()]
        return len(set(numbers)) == len(numbers) and numbers != list(range(len(numbers)))

    def refuse_rows(self, bad: Bools, name: str, what: str) -> None:
        """Note the rows of a column that a format refuses.

        Args:
            bad: which rows, shape (rows,).
            name: the column.
            what: what is wrong, as "is not an angle".
        """
        column = self._column(name)
        if column is not None:
            self._refuse(bad, column, what)

    def _column(self, name: str) -> Column | None:
        key = folded(name)
        self._asked.add(key)
        column = self.table.columns.get(key)
        if column is None and name not in self._lacking:
            self._lacking.append(name)
        return column

    def _is_flat(self, column: Column) -> bool:
        values = column.values
        if values.ndim == 1 and values.dtype.kind in "iufbU":
            return True
        self.note(f"column {column.name} has {_shape(values)}, expected one real number or word")
        return False

    def _factor(self, column: Column, unit: str | None) -> float:
        if unit is None or column.unit is None or column.unit.strip() == "":
            return 1.0
        from astropy import units  # slow to import

        try:
            return float(units.Unit(column.unit, parse_strict="raise").to(unit))
        except (ValueError, TypeError) as error:
            self.note(f"column {column.name} in {column.unit}, expected {unit}: {error}")
            return 1.0

    def _refuse(self, bad: Bools, column: Column, what: str) -> None:
        rows = np.flatnonzero(bad)
        if len(rows):
            values = [_shown(column, row) for row in self._rows[rows[:_NAMED]].tolist()]
            self.note(f"column {column.name} {what}: {self._named(rows)}: {', '.join(values)}")

    def _named(self, rows: NDArray) -> str:
        more = f" and {len(rows) - _NAMED} more" if len(rows) > _NAMED else ""
        if self._ids is not None:
            return "robot " + ", ".join(self._ids[row] for row in rows[:_NAMED]) + more
        return self.table.names_of_rows(self._rows[rows[:_NAMED]].tolist()) + more


def _shown(column: Column, row: int) -> str:
    value = str(column.values[row])
    if value == "" or (column.missing[row] and column.values.dtype.kind not in "Uf"):
        return "nothing"
    return value[:40]


def _shape(values: NDArray) -> str:
    if values.ndim == 1:
        kinds = {"c": "complex numbers", "O": "rows of varying length"}
        return kinds.get(values.dtype.kind, f"{values.dtype} values")
    return f"{' x '.join(str(size) for size in values.shape[1:])} values a row"


def _numbers(values: NDArray) -> tuple[Floats, Bools]:
    if values.dtype.kind in "iuf":
        numbers = values.astype(float)
        return numbers, ~np.isfinite(numbers)
    if values.dtype.kind == "b":
        return np.zeros(len(values)), np.ones(len(values), dtype=bool)
    good = np.array([_NUMBER.match(text) is not None for text in values.tolist()], dtype=bool)
    numbers = np.full(len(values), np.nan)
    numbers[good] = values[good].astype(float)
    return numbers, ~np.isfinite(numbers)


def _whole(value: object) -> int | None:
    if isinstance(value, bool):
        return None
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < 2.0**53 else None
    found = _WHOLE.match(str(value))
    return int(found.group(1)) if found else None
