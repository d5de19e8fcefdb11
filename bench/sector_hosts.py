# SPDX-License-Identifier: Apache-2.0
"""Hosts of a plane of sectors on one machine: network namespaces, and what networks do.

This kernel delays and loses nothing by itself: loss, doubling and delay are those of the sender of
each message here; a host is cut off by taking its link down.
"""

import ctypes
import os
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

__all__ = ["Faults", "Namespaces", "Socket", "enter"]

_NEWNET = 0x40000000
_PORT = 7000
_MTU = "65000"


class Faults(NamedTuple):
    """What happens to messages on their way.

    Args:
        loss: probability that a message is lost.
        doubled: probability that it comes twice.
        jitter_s: mean of its delay, exponential [s].
    """

    loss: float = 0.0
    doubled: float = 0.0
    jitter_s: float = 0.0


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True)


class Namespaces:
    """A network namespace for each sector, linked with that of the coordinator, which is ours."""

    def __init__(self, number: int):
        self.number, self._name = number, f"fs{os.getpid()}"
        for k in range(number):
            inside, ours = self.name(k), self.link(k)
            _ip("netns", "add", inside)
            _ip("link", "add", ours, "mtu", _MTU, "type", "veth", "peer", "name", "up0", "mtu",
                _MTU, "netns", inside)  # fmt: skip
            _ip("addr", "add", f"{self.address(k, ours=True)}/30", "dev", ours)
            _ip("link", "set", ours, "up")
            _ip("-n", inside, "addr", "add", f"{self.address(k)}/30", "dev", "up0")
            _ip("-n", inside, "link", "set", "up0", "up")

    def name(self, sector: int) -> str:
        """Return the name of the namespace of a sector."""
        return f"{self._name}s{sector}"

    def link(self, sector: int) -> str:
        """Return the name of our end of the link with a sector."""
        return f"{self._name}v{sector}"

    @staticmethod
    def address(sector: int, ours: bool = False) -> str:
        """Return the address of a sector, or ours on its link."""
        return f"10.193.{sector}.{1 if ours else 2}"

    def cut(self, sector: int, up: bool = False) -> None:
        """Take the link with a sector down, or up again."""
        _ip("link", "set", self.link(sector), "up" if up else "down")

    def close(self) -> None:
        """Remove the namespaces, and with them their links."""
        for k in range(self.number):
            with suppress(subprocess.CalledProcessError):
                _ip("netns", "del", self.name(k))


def enter(namespace: str) -> None:
    """Let this process, which has one thread, live in a network namespace."""
    with Path(f"/run/netns/{namespace}").open() as file:
        if ctypes.CDLL(None, use_errno=True).setns(file.fileno(), _NEWNET):
            raise OSError(ctypes.get_errno(), f"network namespace {namespace}")


class Socket:
    """Datagrams between a sector and its coordinator, with faults of the network.

    Args:
        own: address of this end.
        other: address of the other end.
        faults: what happens to what is sent.
        rng: source of the faults.
        scale: seconds of the plane's clocks in one of this machine.
    """

    def __init__(
        self, own: str, other: str, faults: Faults, rng: np.random.Generator, scale: float
    ):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.socket.bind((own, _PORT))
        self._other, self._faults, self._rng, self._scale = (other, _PORT), faults, rng, scale

    def send(self, data: bytes) -> None:
        """Send a message, once, twice, late or not at all."""
        loss, doubled, jitter_s = self._faults
        if self._rng.random() < loss:
            return
        for _ in range(2 if self._rng.random() < doubled else 1):
            wait_s = self._rng.exponential(jitter_s) / self._scale if jitter_s else 0.0
            if wait_s:
                threading.Timer(wait_s, self._out, [data]).start()
            else:
                self._out(data)

    def _out(self, data: bytes) -> None:
        with suppress(OSError):  # the link is down
            self.socket.sendto(data, self._other)

    def listen(self, take: Callable[[bytes], None]) -> None:
        """Give each message that comes to `take`, in a thread."""

        def hear() -> None:
            while True:
                try:
                    take(self.socket.recv(1 << 16))
                except OSError:
                    time.sleep(1e-3)

        threading.Thread(target=hear, daemon=True).start()
