# SPDX-License-Identifier: Apache-2.0
"""A kill campaign on several planes at the same time, each in a ROS domain of its own."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from fiber_node.ros_environment import own_domain

__all__ = ["run_jobs"]

_DOMAINS = 101


def run_jobs(
    script: Path, jobs: int, first: int, runs: int, given: Mapping[str, object], logs: Path | None
) -> int:
    """Share the runs of a campaign among processes; return the worst exit code.

    Args:
        script: the script of the campaign.
        jobs: number of processes.
        first: number of the first run.
        runs: number of runs of all processes.
        given: options of all processes, by name.
        logs: folder for the logs, one folder in it for each process.
    """
    started: list[subprocess.Popen[bytes]] = []
    domain, end = own_domain(), first + runs
    for k in range(jobs):
        share = (end - first) // (jobs - k)
        options = {"first": first, "runs": share} | dict(given)
        if logs is not None:
            options["logs"] = logs / str(k)
        command = [sys.executable, str(script), *(f"--{n}={v}" for n, v in options.items())]
        of_its_own = {"ROS_DOMAIN_ID": str((domain + k - 1) % _DOMAINS + 1)}
        started.append(subprocess.Popen(command, env=os.environ | of_its_own))
        first += share
    try:
        return max(abs(job.wait()) for job in started)
    except KeyboardInterrupt:
        return max(abs(job.wait()) for job in started)  # the terminal has interrupted them, too
