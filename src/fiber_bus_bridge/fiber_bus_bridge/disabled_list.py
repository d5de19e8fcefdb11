"""The list of robots that operators have taken out, as it stands on disk."""

import os
from collections.abc import Mapping
from pathlib import Path

import yaml

from fiber_bus_bridge.errors import BridgeError

__all__ = ["read_disabled", "write_disabled"]

_HEAD = "# Robots taken out of use: id, and why. The bus bridge reads it as it starts.\n"


def read_disabled(path: Path) -> dict[int, str]:
    """Return why each robot on the list was taken out, by id; nothing if there is no file yet.

    Raises:
        BridgeError: the file cannot be read, or is no list of ids and reasons; names it.
    """
    try:
        table = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise BridgeError(f"list of disabled robots {path}: {error}") from error
    table = {} if table is None else table
    if not isinstance(table, dict):
        raise BridgeError(f"list of disabled robots {path}: {table!r} is no table of ids")
    for robot, why in table.items():
        if type(robot) is not int or not isinstance(why, str):
            raise BridgeError(
                f"list of disabled robots {path}: {robot!r}: {why!r}, expected an id and a reason"
            )
    return table


def write_disabled(path: Path, table: Mapping[int, str]) -> None:
    """Put the list in the place of the one before: whole, or not at all.

    Raises:
        BridgeError: it cannot be written there.
    """
    text = _HEAD + yaml.safe_dump(dict(sorted(table.items())), allow_unicode=True)
    fresh = path.with_name(path.name + ".new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with open(fresh, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(fresh, path)
    except OSError as error:
        raise BridgeError(f"list of disabled robots {path}: {error}") from error
