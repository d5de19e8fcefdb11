# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes that are forked from one that has imported all of them.

A node that is started from its executable spends seconds of processor time on imports and on
compiled loops. Forked, the same `main` begins at once, in a process of its own: it can be killed,
paused and restarted as any other, and nothing of ROS is there before the fork.
"""

import ctypes
import faulthandler
import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.context import ForkServerProcess
from pathlib import Path

from fiber_bringup import Processes

__all__ = ["MAINS", "ForkedProcess", "ForkedProcesses", "run_forked"]

_PRELOADED = "forked_preload"
MAINS = {
    "plant": "fiber_bus_bridge.plant.main",
    "bridge": "fiber_bus_bridge.node.bridge",
    "planner": "fiber_planner.node",
    "discretizer": "fiber_discretizer.node",
    "recorder": "fiber_recording.node",
    "viewer": "fiber_viewer.node",
    "reconfigure": "fiber_client.reconfigure",
}
_DIES_WITH_PARENT = 1  # PR_SET_PDEATHSIG of Linux
_CONTEXT = multiprocessing.get_context("forkserver")


class ForkedProcess:
    """A forked process, with the part of the interface of `subprocess.Popen` that is used."""

    def __init__(self, process: ForkServerProcess):
        self._process = process
        self.returncode: int | None = None

    @property
    def pid(self) -> int:
        """Its process id."""
        assert self._process.pid is not None  # it was started
        return self._process.pid

    def poll(self) -> int | None:
        """Return the exit code, None while it runs."""
        self.returncode = self._process.exitcode
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; return the exit code.

        Raises:
            TimeoutExpired: it has not ended in time [s].
        """
        self._process.join(timeout)
        code = self.poll()
        if code is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout or 0.0)
        return code

    def send_signal(self, sig: int) -> None:
        """Send a signal, if it runs."""
        if self.poll() is None:
            os.kill(self.pid, sig)


class ForkedProcesses(Processes):
    """As Processes, for the nodes of a plane and the command `reconfigure`.

    Args:
        logs: folder of the log files, which must exist.
        grace_s: time that each way to end a process is given [s].
    """

    def program(self, package: str, executable: str) -> str:
        """Return the module whose function is run, and the name of the function."""
        return MAINS[executable]

    def spawn(self, command: Sequence[str], log: Path, mode: str) -> ForkedProcess:
        """Fork a process that runs a command."""
        arguments = (tuple(command), str(log), mode, dict(os.environ))
        with _found_by_the_server():
            _CONTEXT.set_forkserver_preload([_PRELOADED])
            process = _CONTEXT.Process(target=run_forked, args=arguments, daemon=True)
            process.start()
        return ForkedProcess(process)


@contextmanager
def _found_by_the_server() -> Iterator[None]:
    """Let the server, which is started with the first process, find the modules of this folder."""
    before, here = os.environ.get("PYTHONPATH"), str(Path(__file__).parent)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (here, before)))
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before


def run_forked(command: Sequence[str], log: str, mode: str, environment: dict[str, str]) -> None:
    """Run a command in a process that was just forked; never return.

    Args:
        command: module and arguments.
        log: file for what it prints.
        mode: "wb" to begin the file, "ab" to append to it.
        environment: its environment.
    """
    os.environ.clear()
    os.environ.update(environment)
    os.setsid()  # the owner passes on an interrupt from the terminal
    # and when the server is killed, which nothing would tell the process
    ctypes.CDLL(None).prctl(_DIES_WITH_PARENT, signal.SIGKILL)
    how = os.O_TRUNC if mode == "wb" else os.O_APPEND
    file = os.open(log, os.O_WRONLY | os.O_CREAT | how, 0o600)
    for each in (1, 2):
        os.dup2(file, each)
    faulthandler.register(signal.SIGUSR1)  # a process that hangs tells where, in its log
    sys.argv = list(command)
    sys.exit(importlib.import_module(command[0]).main())
