# SPDX-License-Identifier: Apache-2.0
"""Every example runs to its end with small sizes and says what it did."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
NEEDS_GRAPH = "control_script"
# name -> what it prints, among other things
SAID = {
    "control_script": "a stop in motion",
    "layout_from_csv": "targets.csv: 18 of 19 reached",
    "layout_study": "makespan / bound",
    "own_instrument": "robots reached their targets",
    "own_planner": "outside in: ",
    "three_robots": "robot 11: reached, ok",
}
GRAPH = """
import subprocess, sys
from fiber_bringup import Graph
with Graph(bridge={"preset": "desi", "robots": 37, "time_scale": 0.5}):
    sys.exit(subprocess.run([sys.executable, sys.argv[1]], timeout=500).returncode)
"""


def run(name: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run an example in an empty folder, with a graph of 37 robots where it needs one."""
    script = str(EXAMPLES / f"{name}.py")
    command = ["-c", GRAPH, script] if name == NEEDS_GRAPH else [script]
    return subprocess.run(
        [sys.executable, *command],
        cwd=folder,
        env=os.environ | {"ROBOTS": "37", "SEEDS": "1", "OUT": "made"},
        capture_output=True,
        text=True,
        timeout=600,
    )


def test_every_example_has_a_test():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(SAID)


@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", sorted(SAID))
def test_the_example_runs(name, tmp_path):
    done = run(name, tmp_path)
    assert done.returncode == 0, done.stderr + done.stdout
    assert SAID[name] in done.stdout
    made = sorted(path.name for path in (tmp_path / "made").glob("*"))
    if name == "own_instrument":
        assert made == [
            "plan.npz", "player.html", "problem.npz", "recording.npz", "report.json",
        ]  # fmt: skip
    if name == "layout_study":
        assert made == ["study.png"]


def test_an_own_instrument_takes_about_twenty_lines():
    lines = (EXAMPLES / "own_instrument.py").read_text().splitlines()
    assert len([line for line in lines[4:] if line.strip()]) <= 22
