# SPDX-License-Identifier: Apache-2.0
"""Small files that outlive the bridge: JSON with a checksum, replaced as a whole."""

import json
import os
import zlib
from pathlib import Path

import numpy as np

from fiber_bus_bridge.errors import BridgeError
from fiber_core.array_types import Floats, Ints

__all__ = ["float_column", "int_column", "read_checked", "write_checked"]

_LARGEST = 2**31 - 1


def write_checked(path: Path, content: dict[str, object], name: str, synced: bool = True) -> None:
    """Replace a file as a whole.

    Args:
        path: the file; missing folders are created.
        content: what JSON can hold, with a `format`; the checksum is added.
        name: what the file is, for errors.
        synced: whether it is on disk before the call returns.

    Raises:
        BridgeError: the file cannot be written.
    """
    content = content | {"checksum": _checksum(content)}
    fresh = path.with_name(path.name + ".new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(fresh, "w", encoding="utf-8") as file:
            json.dump(content, file)
            if synced:
                file.flush()
                os.fsync(file.fileno())
        os.replace(fresh, path)
        if synced:
            _sync_folder(path.parent)  # the new name is on disk, too
    except OSError as error:
        raise BridgeError(f"{name} {path}: {error}") from error


def _sync_folder(path: Path) -> None:
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def read_checked(path: Path, file_format: str) -> dict[str, object] | None:
    """Return the content of a file, None if there is no file.

    Args:
        path: the file.
        file_format: the value of its `format`.

    Raises:
        BridgeError: the file cannot be read, is damaged, or of another format.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, RecursionError) as error:
        raise BridgeError(str(error)) from error
    if not isinstance(content, dict) or content.get("format") != file_format:
        raise BridgeError(f"is not a {file_format!r}")
    if content.get("checksum") != _checksum(content):
        raise BridgeError("its checksum is wrong")
    return content


def int_column(content: dict[str, object], name: str, length: int) -> Ints:
    """Return a list of whole numbers in a file, shape (length,).

    Raises:
        BridgeError: it is not there, or is another one.
    """
    values = _list(content, name, length)
    for value in values:
        if type(value) is not int or abs(value) > _LARGEST:
            raise BridgeError(f"{name} holds {value!r}")
    return np.array(values, dtype=np.int64)


def float_column(content: dict[str, object], name: str, length: int) -> Floats:
    """Return a list of numbers in a file, shape (length,); null is nan.

    Raises:
        BridgeError: it is not there, or is another one.
    """
    values = _list(content, name, length)
    for value in values:
        if value is None:
            continue
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not (abs(value) <= _LARGEST)
        ):
            raise BridgeError(f"{name} holds {value!r}")
    return np.array(values, dtype=float)


def _list(content: dict[str, object], name: str, length: int) -> list[object]:
    values = content.get(name)
    if not isinstance(values, list) or len(values) != length:
        raise BridgeError(f"{name} is not a list of {length} numbers")
    return values


def _checksum(content: dict[str, object]) -> int:
    rest = {name: value for name, value in content.items() if name != "checksum"}
    return zlib.crc32(json.dumps(rest, sort_keys=True).encode())
