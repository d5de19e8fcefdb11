# SPDX-License-Identifier: Apache-2.0
"""A kill campaign on several planes at the same time, each in a ROS domain of its own."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from fiber_node.ros_environment import own_domain

__all__ = ["first_left", "run_jobs"]

_DOMAINS = 101


def first_left(lines: Path, seed: int) -> int:
    """Return the number after the last run of a seed, so that a campaign goes on where it ended.

    Args:
        lines: the file of its runs, a line each; it may not exist yet.
        seed: seed of the campaign.
    """
    if not lines.exists():
        return 0
    made = map(json.loads, lines.read_text("utf-8").splitlines())
    return max((run["number"] + 1 for run in made if run["seed"] == seed), default=0)


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
    domain = own_domain()
    for k in range(jobs):  # in turn, so that an interrupted campaign leaves no part out
        share = len(range(k, runs, jobs))
        options = {"first": first + k, "step": jobs, "runs": share} | dict(given)
        if logs is not None:
            options["logs"] = logs / str(k)
        command = [sys.executable, str(script), *(f"--{n}={v}" for n, v in options.items())]
        of_its_own = {"ROS_DOMAIN_ID": str((domain + k - 1) % _DOMAINS + 1)}
        started.append(subprocess.Popen(command, env=os.environ | of_its_own))
    try:
        return max(abs(job.wait()) for job in started)
    except KeyboardInterrupt:
        return max(abs(job.wait()) for job in started)  # the terminal has interrupted them, too
