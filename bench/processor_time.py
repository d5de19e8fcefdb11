# SPDX-License-Identifier: Apache-2.0
"""The time that processes have had of the processors, which other work does not alter much."""

import os
import resource
from pathlib import Path

__all__ = ["of_children_s", "processor_s"]


def processor_s(pid: int) -> float:
    """Return the time that a process has had so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def of_children_s() -> float:
    """Return the time of all children that have ended, and were waited for [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
