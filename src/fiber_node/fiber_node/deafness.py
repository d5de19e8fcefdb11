# SPDX-License-Identifier: Apache-2.0
"""A process that cannot hear any more ends: a fault of the middleware that no setting removes."""

import faulthandler
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

__all__ = ["DEAF_CODE", "watch_hearing"]

DEAF_CODE = 3
_LOOK_S, _LOOKS = 1.0, 5
_FROZEN_S = 60.0  # no callback and no compiled loop keeps the interpreter's lock for that long
_STDERR = 2
_THREAD = "dds.udp."  # and its port: the thread of Fast DDS that receives at a socket
_TASKS, _SOCKETS = Path("/proc/self/task"), Path("/proc/self/net/udp")
_OPEN = Path("/proc/self/fd")


class _Receiver(NamedTuple):
    """A thread that sleeps while messages wait at its socket."""

    port: int
    thread: str
    switches: str  # how often it has gone to sleep


def watch_hearing(end: Callable[[int], None] = os._exit) -> None:
    """End this process, in a thread of its own, once it cannot hear any more.

    In Fast DDS 2.14 the thread that receives and the thread of timers can wait for each other for
    ever, when another process leaves at the wrong moment (eProsima/Fast-DDS issue 6502). The node
    then lives and hears nothing, not even a stop, and no other node finds it. Robots whose bridge
    has ended stop by themselves; a launch notices the end, or starts the node again.

    A thread of Python that waits for the middleware for ever with the interpreter's lock stops all
    others, this one too, while the middleware goes on to tell that the node is alive. After a
    minute the process then prints where each thread is, and ends with code 1. So it does when it
    is woken from a pause that was longer.

    Args:
        end: called with the exit code.
    """
    if _TASKS.is_dir() and _SOCKETS.is_file():  # as on Linux
        threading.Thread(target=_watch, args=(end,), name="hearing", daemon=True).start()


def _watch(end: Callable[[int], None]) -> None:
    looks: dict[_Receiver, int] = {}
    while not looks or max(looks.values()) < _LOOKS:
        # watched by a thread that needs no interpreter; each call begins the time anew
        faulthandler.dump_traceback_later(_FROZEN_S, exit=True, file=_STDERR)
        time.sleep(_LOOK_S)
        looks = {each: looks.get(each, 0) + 1 for each in _asleep()}
    port = max(looks, key=lambda each: looks[each]).port
    # not by a logger, which would publish
    print(
        f"[FATAL] [{time.time():.6f}] [fiber]: this process has not received at port {port} for "
        f"{_LOOKS * _LOOK_S:g} s, a fault of Fast DDS: it ends, start it again",
        file=sys.stderr,
        flush=True,
    )
    end(DEAF_CODE)


def _asleep() -> set[_Receiver]:
    """The receivers that sleep although messages wait."""
    waiting = _ports_with_messages()
    found = set()
    for task in _TASKS.iterdir():
        try:
            name = (task / "comm").read_text(encoding="ascii").strip()
            port = int(name.removeprefix(_THREAD)) if name.startswith(_THREAD) else -1
            if port not in waiting:
                continue
            status = (task / "status").read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError):
            continue  # it has ended, or has another name
        values = dict(line.split(":\t", 1) for line in status if ":\t" in line)
        if values["State"].startswith("S"):
            found.add(_Receiver(port, task.name, values["voluntary_ctxt_switches"]))
    return found


def _ports_with_messages() -> set[int]:
    own = set(_inodes())  # the table has the sockets of all processes
    lines = _SOCKETS.read_text(encoding="ascii").splitlines()[1:]
    columns = [line.split() for line in lines]
    # local address:port, bytes that wait to be sent:received, hexadecimal, and the inode
    return {
        int(each[1].split(":")[1], 16)
        for each in columns
        if each[9] in own and int(each[4].split(":")[1], 16)
    }


def _inodes() -> Iterator[str]:
    for each in _OPEN.iterdir():
        with suppress(OSError):  # it is closed
            target = os.readlink(each)
            if target.startswith("socket:["):
                yield target[len("socket:[") : -1]
