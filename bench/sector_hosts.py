# SPDX-License-Identifier: Apache-2.0
"""Hosts of a plane of sectors on one machine: network namespaces, clocks, what networks do.

This kernel delays and loses nothing by itself: loss, doubling and delay are those of the sender of
each message here; a host is cut off by taking its link down.
"""

import ctypes
import math
import multiprocessing
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

from fiber_bus_bridge.plant import PlantBuses
from fiber_sectors.paced import PacedBuses

__all__ = ["Faults", "HostClock", "Namespaces", "Socket", "Trouble", "TrueBuses", "enter"]

_NEWNET = 0x40000000
_PORT = 7000
_MTU = "65000"


class Trouble:
    """What happens to the victim of a run; all processes of the run see it at once."""

    def __init__(self) -> None:
        # without a lock, with which a process could be killed
        self._at = multiprocessing.RawArray("d", [np.inf, 0.0, 0.0, 0.0, 0.0, np.inf])

    def jump(self, at_s: float, by_s: float) -> None:
        """Let the clock jump at a true time."""
        self._at[:3] = [at_s, by_s, 0.0]

    def drift(self, at_s: float, by_ppm: float) -> None:
        """Let the clock run faster from a true time on."""
        self._at[:3] = [at_s, 0.0, by_ppm]

    def ahead_s(self, t: float) -> float:
        """Return how far the clock is ahead by all that, at a true time [s]."""
        at_s, by_s, by_ppm = self._at[:3]
        return by_s + 1e-6 * by_ppm * (min(t, self._at[5]) - at_s) if t >= at_s else 0.0

    def heal(self, at_s: float) -> None:
        """End the drift, from a true time on, and the faults of messages."""
        self._at[3], self._at[5] = 0.0, at_s

    def disturb(self) -> None:
        """Let messages meet their faults."""
        self._at[3] = 1.0

    def jam(self) -> None:
        """Let a robot jam."""
        self._at[4] = 1.0

    @property
    def disturbed(self) -> bool:
        """Whether messages meet their faults."""
        return bool(self._at[3])

    @property
    def jams(self) -> bool:
        """Whether a robot jams."""
        return bool(self._at[4])


class HostClock:
    """The clock of a host: ahead of the true one, at another rate, and with its trouble.

    Args:
        scale: seconds of the clocks in one of this machine.
        ahead_s: how far it is ahead [s].
        rate_ppm: how much faster it is [1e-6].
        trouble: what happens to it.
    """

    def __init__(self, scale: float, ahead_s: float, rate_ppm: float, trouble: Trouble):
        self._scale, self._ahead_s, self._rate = scale, ahead_s, 1e-6 * rate_ppm
        self._trouble = trouble

    def true_s(self) -> float:
        """Return the true time, that of the robots [s]."""
        return self._scale * time.monotonic()

    def __call__(self) -> float:
        """Return the time of this clock [s]."""
        t = self.true_s()
        return self._ahead_s + t * (1.0 + self._rate) + self._trouble.ahead_s(t)


class TrueBuses(PacedBuses):
    """Buses that live by true time, used by a host that lives by its clock."""

    def __init__(self, buses: PlantBuses, clock: HostClock, scale: float):
        super().__init__(buses, clock, lambda clock_s: time.sleep(clock_s / scale))
        self._host_clock = clock

    def transfer(self, frames, read_bytes, not_before_s, limit_s=math.inf):
        """Carry a batch of messages; see PacedBuses.transfer."""
        self._origin_s = self._host_clock() - self._host_clock.true_s()
        return super().transfer(frames, read_bytes, not_before_s, limit_s)


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
    """A network namespace for each sector, linked with that of the coordinator, which is ours.

    Args:
        number: number of sectors.
        net: the second byte of all addresses; other planes on this machine have another one.
    """

    def __init__(self, number: int, net: int = 193):
        self.number, self._net, self._name = number, net, f"fs{os.getpid()}"
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

    def address(self, sector: int, ours: bool = False) -> str:
        """Return the address of a sector, or ours on its link."""
        return f"10.{self._net}.{sector}.{1 if ours else 2}"

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
        trouble: says when the faults happen.
    """

    def __init__(
        self, own: str, other: str, faults: Faults, rng: np.random.Generator, scale: float,
        trouble: Trouble,
    ):  # fmt: skip
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.socket.bind((own, _PORT))
        self._other, self._faults, self._rng, self._scale = (other, _PORT), faults, rng, scale
        self._trouble = trouble

    def send(self, data: bytes) -> None:
        """Send a message, once, twice, late or not at all."""
        loss, doubled, jitter_s = self._faults if self._trouble.disturbed else Faults()
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
