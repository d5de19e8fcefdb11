"""Nodes as processes of their own: started from the installed executables, watched, ended."""

import json
import os
import signal
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from fiber_bringup.errors import ProcessError

__all__ = ["Processes", "installed"]

_GRACE_S = 10.0  # between one way to end a process and the next, harder one
_TAIL_LINES = 15


@dataclass(frozen=True)
class _Running:
    name: str
    process: subprocess.Popen
    log: Path


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
        raise ProcessError(f"{package} has no executable {executable}: {path} is missing")
    return path


class Processes:
    """Executables that run from `with` to its end, each with a log file.

    At the end each is interrupted as from a terminal, so that it can give back its shared
    memory; one that does not end in time is terminated, and at last killed. One that
    failed is an error.

    Args:
        logs: folder of the log files, which must exist.
        grace_s: how long each way to end a process is given [s].
    """

    def __init__(self, logs: Path, grace_s: float = _GRACE_S):
        self._logs, self._grace_s = Path(logs), grace_s
        self._running: list[_Running] = []

    def __enter__(self) -> "Processes":
        return self

    def __exit__(self, kind, *_):
        ends = self.end()
        if kind is None and any(ends.values()):
            raise ProcessError("; ".join(self._died(running) for running in self._failed()))

    def start(self, package: str, executable: str, parameters: Mapping[str, object]) -> int:
        """Start an installed node with parameters by name; return its process id.

        Raises:
            ProcessError: it is not installed.
        """
        command = [str(installed(package, executable)), "--ros-args"]
        for name, value in parameters.items():
            # as JSON a value is YAML of its own type: "2021" stays a string
            command += ["-p", f"{name}:={json.dumps(value)}"]
        log = self._logs / f"{executable}.log"
        with open(log, "wb") as file:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # an interrupt from the terminal is for us to pass on
            )
        self._running.append(_Running(executable, process, log))
        return process.pid

    def check(self) -> None:
        """Make sure that all still run.

        Raises:
            ProcessError: one has ended; shows the end of its log.
        """
        for running in self._running:
            if running.process.poll() is not None:
                raise ProcessError(self._died(running))

    def end(self) -> dict[str, int]:
        """End all; return their exit codes by executable."""
        for how in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            left = [r.process for r in self._running if r.process.poll() is None]
            for process in left:
                process.send_signal(how)
            for process in left:
                try:
                    process.wait(self._grace_s)
                except subprocess.TimeoutExpired:
                    continue
        return {running.name: running.process.returncode for running in self._running}

    def _failed(self):
        return [running for running in self._running if running.process.returncode]

    def _died(self, running) -> str:
        lines = running.log.read_text(errors="replace").splitlines()[-_TAIL_LINES:]
        said = "\n".join(f"    {line}" for line in lines)
        return (
            f"{running.name} ended with code {running.process.returncode}, {running.log}:\n{said}"
        )
