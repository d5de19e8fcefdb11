# SPDX-License-Identifier: Apache-2.0
"""Tables of a yanny parameter file (.par): structures declared in C, and their rows.

Declarations are read for the names of columns; a column declared as an array of numbers has
several texts a row. Format: SDSS, https://www.sdss.org/dr17/software/par/.
"""

import difflib
import re
from collections.abc import Mapping, Sequence

import numpy as np

from fiber_formats.errors import FormatError
from fiber_formats.table import Column, Table
from fiber_formats.text_tables import MISSING

__all__ = ["is_yanny", "yanny_tables"]

_STRUCT = re.compile(r"typedef\s+struct\s*\{(.*?)\}\s*(\w+)\s*;", re.DOTALL)
_ENUM = re.compile(r"typedef\s+enum\s*\{.*?\}\s*\w+\s*;", re.DOTALL)
_MEMBER = re.compile(r"(\w+)\s+(\w+)((?:\s*\[\s*\d*\s*\])*)\s*;")
_ROW = 3  # values from which a keyword counts as a row of a structure with as many
_NEAR = 0.75  # ratio of equal letters from which a keyword counts as a misspelt structure
_WORD = re.compile(r'"((?:[^"\\]|\\.)*)"|\{\s*\{\s*\}\s*\}|\{([^{}]*)\}|([^\s"{}]+)')


def is_yanny(text: str) -> bool:
    """Return whether a text declares yanny structures."""
    return text.startswith("#%yanny") or _STRUCT.search(text[: 1 << 16]) is not None


def yanny_tables(name: str, text: str) -> tuple[Table, ...]:
    """Return one table for each structure of a yanny file.

    Args:
        name: path of the file, for messages.
        text: its content.

    Raises:
        FormatError: no structure is declared, or a row does not fit its declaration.
    """
    structures = {}
    for body, structure in _STRUCT.findall(text):
        body = re.sub(r"#[^\n]*", "", body)
        structures[structure.upper()] = [
            (member, kind != "char" and "[" in size) for kind, member, size in _MEMBER.findall(body)
        ]
    if not structures:
        raise FormatError(f"{name} declares no yanny structure")
    rows: dict[str, list[list[str | list[str]]]] = {key: [] for key in structures}
    lines: dict[str, list[int]] = {key: [] for key in structures}
    for number, line in _data_lines(name, text):
        key = line.split(None, 1)[0].upper()
        if key in structures:
            words = _words(name, number, line)[1:]
            _check_row(name, number, words, structures[key])
            rows[key].append(words)
            lines[key].append(number)
        else:
            after = any(rows.values())
            _check_keyword(name, number, line, structures, after)
    return tuple(
        _table(f"{name} {key}", structures[key], rows[key], lines[key]) for key in structures
    )


def _data_lines(name: str, text: str) -> list[tuple[int, str]]:
    def blank(found: re.Match[str]) -> str:
        return "\n" * found.group(0).count("\n")  # declarations keep the numbers of lines

    text = _ENUM.sub(blank, _STRUCT.sub(blank, text))
    found, number, pending = [], 0, ""
    for line in re.split(r"\r\n|\n|\r", text):
        number += 1
        joined = pending + line.strip()
        if joined.endswith("\\"):
            pending = joined[:-1] + " "
            continue
        pending = ""
        if joined and joined[0] != "#":
            found.append((number, joined))
    if pending.strip():
        raise FormatError(f"{name}: line {number} goes on, but the file ends there")
    return found


def _words(name: str, number: int, line: str) -> list[str | list[str]]:
    words: list[str | list[str]] = []
    at = 0
    while at < len(line):
        if line[at].isspace():
            at += 1
            continue
        if line[at] == "#":
            break
        found = _WORD.match(line, at)
        if found is None:
            raise FormatError(f"{name}: line {number}: a quote or brace is not closed")
        quoted, several, plain = found.groups()
        if several is not None:
            words.append(several.split())
        else:
            words.append(plain if plain is not None else quoted or "")
        at = found.end()
    return words


def _check_keyword(
    name: str,
    number: int,
    line: str,
    structures: Mapping[str, Sequence[tuple[str, bool]]],
    after: bool,
) -> None:
    # A line that is no row of a structure gives the value of a keyword; it is refused where it may
    # be a row under another name: nearly that of a structure, with the values of one, or with
    # several values behind the first row.
    key = line.split(None, 1)[0]
    hint = ""
    meant = difflib.get_close_matches(key.upper(), structures, 1, _NEAR)
    if not meant and "{" not in line:
        values = len(_words(name, number, line)) - 1
        sizes = {len(members): structure for structure, members in structures.items()}
        if values in sizes and values >= _ROW:
            hint = f"; it has the {values} values of a row of {sizes[values]}"
        elif not (after and values > 1):
            return
    elif meant:
        hint = f"; is {meant[0]} meant?"
    raise FormatError(f"{name}: line {number} is of no structure: {key[:40]}{hint}")


def _check_row(
    name: str, number: int, words: list[str | list[str]], members: list[tuple[str, bool]]
) -> None:
    if len(words) != len(members):
        raise FormatError(
            f"{name}: line {number} has {len(words)} values, {len(members)} are declared"
        )
    for word, (member, is_array) in zip(words, members):
        if isinstance(word, list) != is_array:
            raise FormatError(f"{name}: line {number}: {member} is not as declared")


def _table(
    label: str,
    members: list[tuple[str, bool]],
    rows: list[list[str | list[str]]],
    lines: list[int],
) -> Table:
    columns = []
    for k, (member, is_array) in enumerate(members):
        values = [row[k] for row in rows]
        if is_array:  # of no use to any format; kept so that a message can tell its shape
            sizes = max((len(value) for value in values), default=0)
            columns.append(Column(member, np.zeros((len(rows), sizes)), np.zeros(len(rows), bool)))
            continue
        texts = np.array(values, dtype=str).reshape(len(rows))
        missing = np.isin(np.char.lower(texts), MISSING) if len(rows) else np.zeros(0, bool)
        columns.append(Column(member, texts, missing))
    return Table(label, columns, lines)
