# SPDX-License-Identifier: Apache-2.0
"""The log lines of a graph are read on /rosout, in a process with no other graph before."""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.timeout(600)
def test_an_operator_reads_what_nodes_wait_for_and_what_calls_do():
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", str(Path(__file__).with_name("log_lines.py"))],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
