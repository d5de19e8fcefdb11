# SPDX-License-Identifier: Apache-2.0
"""The connection of a bridge or a reader with a plant: one request, one answer."""

import socket
import time
from collections.abc import Callable
from pathlib import Path

from numpy.typing import ArrayLike

from fiber_bus_bridge.plant.messages import (
    ANSWERS,
    REQUESTS,
    Columns,
    Kind,
    PlantError,
    Unpacker,
    pack,
)
from fiber_bus_bridge.plant.paths import check_path

__all__ = ["PlantLink"]

_CHUNK = 1 << 18
_RETRY_S = 0.05


class PlantLink:
    """A connection with the plant behind a socket.

    Args:
        path: the socket of the plant.
        timeout_s: longest time for one answer [s].
    """

    def __init__(self, path: Path, timeout_s: float):
        self._path, self._timeout_s = path, timeout_s
        self._socket: socket.socket | None = None
        self._unpacker = Unpacker(ANSWERS)

    @property
    def connected(self) -> bool:
        """Whether there is a connection, as far as the last request showed."""
        return self._socket is not None

    def connect(
        self,
        wait_s: float,
        clock: Callable[[], float] = time.monotonic,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        """Connect with the plant, and wait for it to appear.

        Raises:
            PlantError: no plant was there in time.
        """
        address, until_s = check_path(self._path), clock() + wait_s
        self.close()
        while True:
            made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            made.settimeout(self._timeout_s)
            try:
                made.connect(address)
            except OSError as error:
                made.close()
                if clock() >= until_s:
                    raise PlantError(f"no plant at {self._path}: {error}") from error
                pause(_RETRY_S)
                continue
            self._socket, self._unpacker = made, Unpacker(ANSWERS)
            return

    def ask(self, kind: Kind, within_s: float | None = None, /, **columns: ArrayLike) -> Columns:
        """Send a request and return the columns of its answer.

        Args:
            kind: the kind of the request.
            within_s: longest time for this answer, if another than for the others [s].
            columns: its columns.

        Raises:
            PlantError: the plant refuses the request, or is gone; then the link is not connected.
        """
        if self._socket is None:
            raise PlantError(f"no connection with the plant at {self._path}")
        try:
            self._socket.settimeout(self._timeout_s if within_s is None else within_s)
            self._socket.sendall(pack(REQUESTS, kind, **columns))
            while (answer := self._unpacker.take()) is None:
                data = self._socket.recv(_CHUNK)
                if not data:
                    raise OSError("the connection has ended")
                self._unpacker.feed(data)
        except (OSError, PlantError) as error:
            self.close()
            raise PlantError(f"the plant at {self._path} is gone: {error}") from error
        if answer[0] is Kind.REFUSED:
            raise PlantError(f"the plant refuses: {answer[1]['text'].tobytes().decode()}")
        return answer[1]

    def close(self) -> None:
        """End the connection."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
