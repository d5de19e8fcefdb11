# SPDX-License-Identifier: Apache-2.0
"""The file with the list of robots that operators have disabled."""

import os
from collections.abc import Mapping
from pathlib import Path

import yaml

from fiber_bus_bridge.errors import BridgeError

__all__ = ["read_disabled", "write_disabled"]

_HEAD = "# Disabled robots: id and reason. The bus bridge reads this file when it starts.\n"


def read_disabled(path: Path) -> dict[int, str]:
    """Return the reason of each disabled robot by id; an empty list if there is no file.

    Raises:
        BridgeError: the file cannot be read, or is not a table of ids and reasons.
    """
    try:
        table = yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise BridgeError(f"list of disabled robots {path}: {error}") from error
    table = {} if table is None else table
    if not isinstance(table, dict):
        raise BridgeError(f"list of disabled robots {path}: {table!r} is not a table of ids")
    for robot, reason in table.items():
        if type(robot) is not int or not isinstance(reason, str):
            raise BridgeError(
                f"list of disabled robots {path}: {robot!r}: {reason!r}, "
                "expected an id and a reason"
            )
    return table


def write_disabled(path: Path, table: Mapping[int, str]) -> None:
    """Replace the file as a whole: after an error the previous list is still there.

    Args:
        path: the file; missing folders are created.
        table: reason of each disabled robot by id.

    Raises:
        BridgeError: the file cannot be written.
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
