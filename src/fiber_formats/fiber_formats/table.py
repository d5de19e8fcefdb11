# SPDX-License-Identifier: Apache-2.0
"""A table of a file: named columns of texts or numbers, with what is missing in each."""

import re
from dataclasses import dataclass

from numpy.typing import NDArray

from fiber_core.array_types import Bools
from fiber_formats.errors import FormatError

__all__ = ["Column", "Table", "folded"]


def folded(name: str) -> str:
    """Return a column name in lower case, with underscores for blanks, dots and hyphens."""
    return re.sub(r"[\s.\-]+", "_", name.strip().lstrip("\ufeff").strip()).casefold()


@dataclass(frozen=True, eq=False)
class Column:
    """One column.

    Args:
        name: as the file spells it.
        values: texts, numbers or flags, first axis of the table's length.
        missing: whether a value is masked or empty, shape (rows,).
        unit: as the file spells it, None without one.
    """

    name: str
    values: NDArray
    missing: Bools
    unit: str | None = None


class Table:
    """Columns of equal length.

    Args:
        label: file, and HDU where there are several, as messages show it.
        columns: the columns.
        lines: line of each row in a text file, from 1; None in other files.

    Raises:
        FormatError: two columns have the same name but for case.
    """

    def __init__(self, label: str, columns: list[Column], lines: list[int] | None = None):
        self.label = label
        self.columns = {folded(column.name): column for column in columns if column.name.strip()}
        self.unnamed = sum(not column.name.strip() for column in columns)
        self.rows = len(columns[0].values) if columns else 0
        self.lines = lines
        if len(self.columns) + self.unnamed < len(columns):
            seen: dict[str, str] = {}
            for column in columns:
                key = folded(column.name)
                if key and key in seen:
                    raise FormatError(
                        f"{label}: a column stands twice: {seen[key]} and {column.name}"
                    )
                seen[key] = column.name

    @property
    def names(self) -> list[str]:
        """Names of the columns as the file spells them."""
        return [column.name for column in self.columns.values()]

    def has(self, *names: str) -> bool:
        """Return whether all these columns are there, whatever their case."""
        return all(folded(name) in self.columns for name in names)

    def __contains__(self, name: str) -> bool:
        return folded(name) in self.columns

    def names_of_rows(self, rows: list[int]) -> str:
        """Return how messages call rows: by their lines in a text file, else by their numbers."""
        if self.lines is not None:
            return "line " + ", ".join(str(self.lines[row]) for row in rows)
        return "row " + ", ".join(str(row + 1) for row in rows)
