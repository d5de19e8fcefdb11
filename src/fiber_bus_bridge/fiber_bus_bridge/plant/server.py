# SPDX-License-Identifier: Apache-2.0
"""The server of a plant: one bridge and any number of readers of the truth on a local socket."""

import fcntl
import logging
import os
import select
import selectors
import socket
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from fiber_bus_bridge.bus import Recovery
from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.plant.messages import (
    ANSWERS,
    REQUESTS,
    Columns,
    Kind,
    PlantError,
    Unpacker,
    pack,
    refusal,
)
from fiber_bus_bridge.plant.paths import check_path
from fiber_bus_bridge.plant.plant import Plant
from fiber_bus_bridge.wire import Addresses, Frames
from fiber_core.array_types import Ids

__all__ = ["PlantServer", "listen"]

_CHUNK = 1 << 18
_IDLE_S, _RUNNING_S = 0.05, 0.02  # between two looks at the time of the machine
_PEER = struct.Struct("3i")  # pid, uid, gid


def listen(path: Path) -> tuple[socket.socket, int]:
    """Return a listening socket at a path, readable by this user alone, and the lock of the path.

    Raises:
        PlantError: another plant has the path, or a socket cannot be made there.
    """
    address = check_path(path)
    lock = os.open(f"{path}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise PlantError(f"another plant serves {path}: end it, or choose another path") from None
    path.unlink(missing_ok=True)  # of a plant that was killed
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    before = os.umask(0o177)
    try:
        listener.bind(address)
    except OSError as error:
        raise PlantError(f"{path}: {error}") from error
    finally:
        os.umask(before)
    listener.listen()
    listener.setblocking(False)
    return listener, lock


class _Connection:
    """One connected process: bytes received and not taken, bytes not sent yet."""

    def __init__(self, made: socket.socket):
        made.setblocking(False)
        self.socket, self.unpacker, self.unsent = made, Unpacker(REQUESTS), b""
        peer = made.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER.size)
        self.pid = _PEER.unpack(peer)[0]

    def hung_up(self) -> bool:
        """Whether the other side is gone: a request that it left behind must not be carried out."""
        poll = select.poll()
        poll.register(self.socket, select.POLLRDHUP)
        return bool(poll.poll(0))


class PlantServer:
    """Serves a plant: each request of a connected process gets one answer.

    Args:
        plant: the plant.
        ids: robot ids, in the order of the plant's rows.
        listener: the listening socket.
        clock: returns the time of the machine [s].
        log: takes what is said about connections and time.
    """

    def __init__(
        self,
        plant: Plant,
        ids: Ids,
        listener: socket.socket,
        clock: Callable[[], float],
        log: logging.Logger | None = None,
    ):
        self._plant, self._ids, self._clock = plant, ids, clock
        self._listener, self._log = listener, log or logging.getLogger("plant")
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener, selectors.EVENT_READ)
        self._bridge: _Connection | None = None
        self._runs_on = False
        self.keep_time: Callable[[], None] = lambda: None  # called when time has gone on
        # positioners may change their address by a fault; a bridge knows the first ones
        self._addresses = plant.robots.addresses
        self._calls: dict[Kind, Callable[[_Connection, Columns], bytes]] = {
            Kind.OPEN: self._open,
            Kind.TRANSFER: self._transfer,
            Kind.RECOVER: self._recover,
            Kind.ALERTS: self._alerts,
            Kind.TRUTH: self._truth,
        }

    def serve(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Serve until `ended` says so, or an exception such as an interrupt ends it."""
        while not ended():
            self.step(_RUNNING_S if self._runs_on else _IDLE_S)

    def step(self, wait_s: float) -> None:
        """Serve what has come, or wait for it; then let time go on if the bridge is silent."""
        served = False
        for key, events in self._selector.select(wait_s):
            if key.data is None:
                self._accept()
                continue
            if events & selectors.EVENT_WRITE:
                self._send(key.data, b"")
            if events & selectors.EVENT_READ:
                self._receive(key.data)
                served = served or key.data is self._bridge
        # a request that waits is served before time goes on: this process may have been paused
        if not served:
            self._run_on()

    def close(self, lock: int) -> None:
        """Close all connections, and give the path and its lock back."""
        for key in list(self._selector.get_map().values()):
            (self._listener if key.data is None else key.data.socket).close()
        self._selector.close()
        os.close(lock)

    def _run_on(self) -> None:
        runs_on = self._plant.run_on(self._clock())
        if runs_on:
            self.keep_time()
        if runs_on and not self._runs_on:
            why = "does not talk" if self._plant.connected else "is gone"
            self._log.warning("the bridge %s: time goes on by itself", why)
        elif self._runs_on and not runs_on:
            self._log.info("%.3f s: all robots are at rest", self._plant.now_s)
        self._runs_on = runs_on

    def _accept(self) -> None:
        try:
            made, _ = self._listener.accept()
        except OSError:
            return
        self._selector.register(made, selectors.EVENT_READ, _Connection(made))

    def _receive(self, connection: _Connection) -> None:
        try:
            data = connection.socket.recv(_CHUNK)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._drop(connection)
            return
        connection.unpacker.feed(data)
        try:
            while (request := connection.unpacker.take()) is not None:
                if request[0] is not Kind.TRUTH and connection.hung_up():
                    self._drop(connection)
                    return
                self._send(connection, self._answer(connection, *request))
        except PlantError as error:
            self._log.error("process %d sent no request: %s", connection.pid, error)
            self._drop(connection)

    def _answer(self, connection: _Connection, kind: Kind, columns: Columns) -> bytes:
        try:
            if kind not in (Kind.OPEN, Kind.TRUTH) and connection is not self._bridge:
                raise PlantError(f"{kind.name} from process {connection.pid}, which has no buses")
            answer = self._calls[kind](connection, columns)
            self.keep_time()
            return answer
        except (BridgeError, ValueError, IndexError) as error:
            self._log.error("process %d is refused: %s", connection.pid, error)
            return refusal(str(error))

    def _send(self, connection: _Connection, data: bytes) -> None:
        connection.unsent += data
        try:
            sent = connection.socket.send(connection.unsent)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop(connection)
            return
        connection.unsent = connection.unsent[sent:]
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if connection.unsent else 0)
        if connection.socket.fileno() in self._selector.get_map():
            self._selector.modify(connection.socket, events, connection)

    def _drop(self, connection: _Connection) -> None:
        if connection.socket.fileno() < 0:
            return
        self._selector.unregister(connection.socket)
        connection.socket.close()
        if connection is self._bridge:
            self._bridge = None
            self._plant.close()
            self._log.info(
                "%.3f s: bridge %d is gone, %d robots move, %d orders wait",
                self._plant.now_s, connection.pid, self._plant.moving, self._plant.waiting,
            )  # fmt: skip

    # --- requests ------------------------------------------------------------

    def _open(self, connection: _Connection, columns: Columns) -> bytes:
        if self._bridge is not None and self._bridge is not connection:
            raise PlantError(f"the buses are in use by a bridge, process {self._bridge.pid}")
        to = self._addresses
        own = {"ids": self._ids, "bus": to.bus, "address": to.address, "ten_bit": to.ten_bit}
        if len(columns["ids"]) != len(self._ids):
            raise PlantError(
                f"the bridge has {len(columns['ids'])} robots, this plant {len(self._ids)}"
            )
        for name, values in own.items():
            wrong = columns[name] != values
            if wrong.any():
                at = int(np.argmax(wrong))
                raise PlantError(
                    f"robot {self._ids[at]} has {name} {values[at]} in this plant, "
                    f"{columns[name][at]} in the bridge: they have different planes"
                )
        clock_hz = self._plant.buses.timing.clock_hz
        if columns["clock_hz"][0] != clock_hz:
            raise PlantError(
                f"the bus clock is {clock_hz:g} Hz in this plant, "
                f"{columns['clock_hz'][0]:g} Hz in the bridge"
            )
        self._bridge = connection
        self._plant.open(self._clock())
        self._log.info("%.3f s: bridge %d is connected", self._plant.now_s, connection.pid)
        return pack(ANSWERS, Kind.OPEN, now_s=self._plant.now_s)

    def _transfer(self, connection: _Connection, columns: Columns) -> bytes:
        to = Addresses(columns["bus"], columns["address"], columns["ten_bit"])
        frames = Frames(to, columns["offsets"], columns["data"])
        f = len(frames)
        read = np.broadcast_to(columns["read_bytes"], (f,))
        before_s = np.broadcast_to(columns["not_before_s"], (f,))
        if (read < 0).any() or not np.isfinite(before_s).all():
            raise PlantError("a frame reads fewer than no bytes, or has no finite time")
        replies = self._plant.transfer(frames, read, before_s, self._clock())
        return pack(
            ANSWERS, Kind.TRANSFER, ack=replies.ack, start_s=replies.start_s, end_s=replies.end_s,
            offsets=replies.offsets, data=replies.data,
        )  # fmt: skip

    def _recover(self, connection: _Connection, columns: Columns) -> bytes:
        bus, recovery = int(columns["bus"][0]), Recovery(int(columns["recovery"][0]))
        end_s, free = self._plant.recover(bus, recovery, float(columns["t"][0]), self._clock())
        return pack(ANSWERS, Kind.RECOVER, end_s=end_s, free=free)

    def _alerts(self, connection: _Connection, columns: Columns) -> bytes:
        low = self._plant.alert_lines(float(columns["t"][0]), self._clock())
        return pack(ANSWERS, Kind.ALERTS, bus=low)

    def _truth(self, connection: _Connection, columns: Columns) -> bytes:
        truth, memory = self._plant.truth, self._plant.robots.memory
        since = int(columns["since"][0])
        first, start, moves, controller, verified = self._plant.true_movements(since)
        return pack(
            ANSWERS, Kind.TRUTH, now_s=self._plant.now_s, bridge=self._plant.controller,
            first=first, quantum_rad=truth.quantum_rad, start=start, position=memory["position"],
            state=memory["state"], controller=controller, verified=verified, **moves._asdict(),
        )  # fmt: skip
