# SPDX-License-Identifier: Apache-2.0
"""Plant and nodes as processes: started from the installed executables, watched, and ended."""

import json
import os
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from fiber_bringup.errors import ProcessError

__all__ = ["Processes", "RunningProcess", "installed"]

_GRACE_S = 10.0  # between one way to end a process and the next, harder one
_TAIL_LINES = 15


class RunningProcess(Protocol):
    """What is used of a process, as `subprocess.Popen` has it."""

    returncode: int | None

    @property
    def pid(self) -> int:
        """Its process id."""
        ...

    def poll(self) -> int | None:
        """Return its exit code, None while it runs."""
        ...

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end [s]; raise TimeoutExpired if it does not come."""
        ...

    def send_signal(self, sig: int) -> None:
        """Send a signal."""
        ...


@dataclass(frozen=True)
class _Started:
    name: str
    process: RunningProcess
    log: Path
    command: tuple[str, ...]

    def error(self) -> str:
        lines = self.log.read_text(errors="replace").splitlines()[-_TAIL_LINES:]
        tail = "\n".join(f"    {line}" for line in lines)
        return f"{self.name} ended with code {self.process.returncode}, {self.log}:\n{tail}"


def _private(path: str, flags: int) -> int:
    # what a node prints is for its owner: the address of the console has its token
    opened = os.open(path, flags, 0o600)
    os.fchmod(opened, 0o600)  # of an earlier run, too
    return opened


def installed(package: str, executable: str) -> Path:
    """Return the path of an installed executable.

    Raises:
        ProcessError: the package is not in this environment, or has no such executable.
    """
    try:
        path = Path(get_package_prefix(package)) / "lib" / package / executable
    except (PackageNotFoundError, OSError):
        raise ProcessError(
            f"package {package} is not installed here: make build, source install/setup.bash"
        ) from None
    if not os.access(path, os.X_OK):
        raise ProcessError(f"package {package} has no executable {executable}: {path} is missing")
    return path


class Processes:
    """Executables that run from `with` to its end, each with a log file.

    At the end each process is interrupted as from a terminal, so that it can give back its shared
    memory; a process that does not end in time is terminated, and at last killed. A process that
    failed is an error.

    Args:
        logs: folder of the log files, which must exist.
        grace_s: time that each way to end a process is given [s].
    """

    def __init__(self, logs: Path, grace_s: float = _GRACE_S):
        self._logs, self._grace_s = Path(logs), grace_s
        self._started: dict[str, _Started] = {}  # by executable

    def __enter__(self) -> "Processes":
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        codes = self.end()
        if kind is None and any(codes.values()):
            failed = (each for each in self._started.values() if each.process.returncode)
            raise ProcessError("; ".join(each.error() for each in failed))

    def start(self, package: str, executable: str, parameters: Mapping[str, object]) -> int:
        """Start an installed node; return its process id.

        Args:
            package: name of its package.
            executable: name of the executable.
            parameters: parameters of the node, by name.

        Raises:
            ProcessError: it is not installed.
        """
        arguments = ["--ros-args"]
        for name, value in parameters.items():
            # as JSON a value is YAML of its own type: "2021" stays a string
            arguments += ["-p", f"{name}:={json.dumps(value)}"]
        return self.start_command(package, executable, arguments)

    def start_command(self, package: str, executable: str, arguments: Sequence[str]) -> int:
        """Start an installed executable that is no node; return its process id.

        Args:
            package: name of its package.
            executable: name of the executable.
            arguments: its command line.

        Raises:
            ProcessError: it is not installed, or runs already.
        """
        before = self._started.get(executable)
        if before is not None and before.process.poll() is None:
            raise ProcessError(f"{executable} runs already, process {before.process.pid}")
        command = [self.program(package, executable), *arguments]
        return self._run(executable, command, self._logs / f"{executable}.log", "wb").pid

    def _run(self, name: str, command: Sequence[str], log: Path, mode: str) -> RunningProcess:
        process = self.spawn(command, log, mode)
        self._started[name] = _Started(name, process, log, tuple(command))
        return process

    def program(self, package: str, executable: str) -> str:
        """Return what stands first in the command of an executable: its path.

        Raises:
            ProcessError: it is not installed.
        """
        return str(installed(package, executable))

    def spawn(self, command: Sequence[str], log: Path, mode: str) -> RunningProcess:
        """Start a process.

        Args:
            command: its program and arguments.
            log: file for what it prints.
            mode: how the file is opened: "wb" or "ab".
        """
        with open(log, mode, opener=_private) as file:
            return subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # this process passes on an interrupt from the terminal
            )

    def send(self, executable: str, what: signal.Signals) -> None:
        """Send a signal to a process; a process that is killed is gone when this returns."""
        process = self._started[executable].process
        process.send_signal(what)
        if what is signal.SIGKILL:
            process.wait()

    def restart(self, executable: str) -> int:
        """Start a process that has ended once more, with its command; return its process id."""
        ended = self._started[executable]
        return self._run(executable, ended.command, ended.log, "ab").pid

    def ended(self) -> list[str]:
        """Return the executables of the processes that have ended."""
        return [each.name for each in self._started.values() if each.process.poll() is not None]

    def memory_mb(self) -> dict[str, tuple[int, float]]:
        """Return process id and resident memory [MB] of each process that runs, by executable."""
        found = {}
        for name, each in self._started.items():
            try:
                pages = int(Path(f"/proc/{each.process.pid}/statm").read_text().split()[1])
            except (OSError, IndexError):
                continue
            found[name] = each.process.pid, round(pages * os.sysconf("SC_PAGE_SIZE") / 1e6, 1)
        return found

    def check(self) -> None:
        """Make sure that all processes still run.

        Raises:
            ProcessError: a process has ended; shows the end of its log.
        """
        for started in self._started.values():
            if started.process.poll() is not None:
                raise ProcessError(started.error())

    def end(self) -> dict[str, int | None]:
        """End all processes; return their exit codes by executable, None for one that runs on."""
        for how in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            left = list(self._running())
            for process in left:
                process.send_signal(how)
            for process in left:
                try:
                    process.wait(self._grace_s)
                except subprocess.TimeoutExpired:
                    continue
        return {started.name: started.process.returncode for started in self._started.values()}

    def _running(self) -> Iterator[RunningProcess]:
        return (each.process for each in self._started.values() if each.process.poll() is None)
