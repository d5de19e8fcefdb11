# SPDX-License-Identifier: Apache-2.0
"""Tables in text: CSV with commas, semicolons, tabs or blanks, and ECSV. Nothing is repaired.

Blank lines and lines that begin with # are skipped. A quote that is not closed on its line and a
line with more or fewer values than columns are refused by line.
"""

import csv
import re

import numpy as np

from fiber_core.array_types import Bools
from fiber_formats.errors import FormatError
from fiber_formats.table import Column, Table, folded

__all__ = ["MISSING", "text_tables"]

_MOST_HEADER = 1 << 20  # bytes of a header; real ones have up to 0.2 MB
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")
MISSING = ("", "nan", "null", "none", "na", "n/a", "--", "masked")  # in lower case


def text_tables(name: str, text: str) -> tuple[Table, ...]:
    """Return the table in a text.

    Args:
        name: path of the file, for messages.
        text: its content.

    Raises:
        FormatError: there is no line with names of columns, a line does not fit it, a quote is
            not closed, or the header is over 1 MB.
    """
    lines = re.split(r"\r\n|\n|\r", text)
    is_ecsv = lines[0].startswith("# %ECSV")
    numbered = [(k + 1, line) for k, line in enumerate(lines) if line.strip() and line[0] != "#"]
    head = sum(len(line) + 1 for line in lines[: numbered[0][0] if numbered else len(lines)])
    if head > _MOST_HEADER:
        raise FormatError(f"{name}: the header has {head} bytes, more than {_MOST_HEADER}")
    if not numbered:
        raise FormatError(f"{name} is empty: it has no line with names of columns")
    types: list[dict[str, str]] = []
    delimiter = _delimiter(numbered[0][1])
    if is_ecsv:
        types, delimiter = _ecsv_header(name, lines[: numbered[0][0] - 1])
    names, *rows = _split(name, numbered, delimiter)
    names = [word.strip().lstrip("\ufeff") for word in names]
    if any(_NUMBER.match(word) for word in names):
        raise FormatError(
            f"{name}: line {numbered[0][0]} holds values and no names of columns: write the names "
            "in the first line, without #"
        )
    return (_table(name, names, rows, [number for number, _ in numbered[1:]], types),)


def _table(
    name: str,
    names: list[str],
    rows: list[list[str]],
    lines: list[int],
    types: list[dict[str, str]],
) -> Table:
    kinds = {entry["name"]: entry for entry in types}
    lacking = [key for key in kinds if key not in names]
    if lacking:
        raise FormatError(f"{name}: the ECSV header describes columns not there: {lacking}")
    texts = np.array(rows, dtype=str).reshape(len(rows), len(names))
    columns = []
    for k, column in enumerate(names):
        kind = kinds.get(column, {})
        values = np.char.strip(texts[:, k]) if len(rows) else texts[:, k]
        if "complex" in kind.get("datatype", ""):
            values = np.array([complex(0, np.nan)] * len(rows))  # refused wherever it is used
        elif "[" in kind.get("subtype", ""):
            values = np.zeros((len(rows), 0))
        columns.append(Column(column, values, _missing(texts[:, k]), kind.get("unit")))
    return Table(name, columns, lines)


def _missing(texts: np.ndarray) -> Bools:
    return np.isin(np.char.lower(np.char.strip(texts)), MISSING)


def _delimiter(header: str) -> str | None:
    counts = {mark: header.count(mark) for mark in (",", ";", "\t")}
    best = max(counts, key=counts.__getitem__)
    return best if counts[best] else None


def _split(name: str, numbered: list[tuple[int, str]], delimiter: str | None) -> list[list[str]]:
    rows = []
    for number, line in numbered:
        row = line.split() if delimiter is None else _fields(name, number, line, delimiter)
        if rows and len(row) != len(rows[0]):
            raise FormatError(
                f"{name}: line {number} has {len(row)} values, the header names {len(rows[0])} "
                "columns"
            )
        rows.append(row)
    return rows


def _fields(name: str, number: int, line: str, delimiter: str) -> list[str]:
    if '"' not in line and delimiter != " ":
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, strict=True, skipinitialspace=True))
    except csv.Error as error:
        problem = "a quote is not closed" if "end of data" in str(error) else str(error)
        raise FormatError(f"{name}: line {number}: {problem}") from None


def _ecsv_header(name: str, lines: list[str]) -> tuple[list[dict[str, str]], str]:
    # The header is YAML; a reader of YAML needs a second for the 0.2 MB of a DESI state, of which
    # only the descriptions of columns matter. Those are cut out.
    comments = [line[2:] for line in lines if line.startswith("# ")]
    try:
        first = comments.index("datatype:")
    except ValueError:
        raise FormatError(f"{name}: the ECSV header has no datatype") from None
    last = first + 1
    while last < len(comments) and comments[last].startswith(("- ", "  ")):
        last += 1
    from astropy.io.misc import yaml  # slow to import

    try:
        described = yaml.load("\n".join(comments[first:last]))["datatype"]
        delimiters = [yaml.load(c)["delimiter"] for c in comments if c.startswith("delimiter:")]
        types = [{key: str(value) for key, value in entry.items()} for entry in described]
    except Exception as error:  # the YAML reader raises errors of many types
        raise FormatError(f"{name}: the ECSV header cannot be read: {error}") from None
    if any("name" not in entry for entry in types):
        raise FormatError(f"{name}: the ECSV header describes a column without name")
    names = [folded(entry["name"]) for entry in types]
    if len(set(names)) < len(names):
        raise FormatError(f"{name}: the ECSV header describes a column twice")
    return types, delimiters[0] if delimiters else " "
