# SPDX-License-Identifier: Apache-2.0
"""The path of a plant's socket, in a folder that only its owner can read."""

import os
import stat
import tempfile
from pathlib import Path

from fiber_bus_bridge.plant.messages import PlantError

__all__ = ["MOST_PATH_BYTES", "check_path", "plant_socket"]

MOST_PATH_BYTES = 107  # of the address of a Unix socket


def plant_socket(name: str = "") -> Path:
    """Return the path of the socket of this user's plant in the ROS domain of the environment.

    The variable FIBER_PLANT holds another path. Otherwise the socket is in XDG_RUNTIME_DIR, or,
    without one, in a folder of this user below the folder for temporary files.

    Args:
        name: name of the plane, where several planes share a domain; slashes become dots.

    Raises:
        PlantError: the folder belongs to another user, or can be read by others.
    """
    given = os.environ.get("FIBER_PLANT")
    if given:
        return Path(given)
    base = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(base) if base else Path(tempfile.gettempdir()) / f"fiber-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.stat()
    if found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o077:
        raise PlantError(f"folder {folder} is not readable by this user alone: no socket is put in")
    suffix = name.strip("/").replace("/", ".")
    domain = os.environ.get("ROS_DOMAIN_ID") or "0"
    return folder / f"fiber-plant-{domain}{'-' * bool(suffix)}{suffix}.sock"


def check_path(path: Path) -> str:
    """Return a path as the address of a socket.

    Raises:
        PlantError: the path is longer than an address can be.
    """
    size = len(os.fsencode(path))
    if size > MOST_PATH_BYTES:
        raise PlantError(f"{path} has {size} bytes, a socket has at most {MOST_PATH_BYTES}")
    return str(path)
