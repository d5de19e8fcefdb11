# SPDX-License-Identifier: Apache-2.0
"""The commands of make that need no `ros2`: from a recording, and on a running plane."""

import os
import re
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from fiber_recording import save_recording
from fiber_recording.examples import random_recording

ROOT = Path(__file__).parents[1]
WAIT_S = 240
pytestmark = [
    pytest.mark.timeout(600),
    pytest.mark.skipif(
        not (shutil.which("make") and (ROOT / "install/setup.bash").exists()),
        reason="NOT TESTED: the commands of make: needs make and a built workspace",
    ),
]


def make(*words, domain=None, fails=False):
    """Run a target of the workspace as it is built; return what it prints."""
    ran = subprocess.run(
        # -o: what is built is not built again, whatever has changed since
        ["make", "-o", "build/.built", *map(str, words)],
        cwd=ROOT, env=_environment(domain), capture_output=True, text=True, check=False,
        timeout=WAIT_S,
    )  # fmt: skip
    said = ran.stdout + ran.stderr
    assert (ran.returncode != 0) == fails, said
    assert "Traceback" not in said
    return said


def _environment(domain):
    own = {
        name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MAKELEVEL")
    }
    return own if domain is None else own | {"ROS_DOMAIN_ID": str(domain)}


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("made") / "recording.npz"
    save_recording(path, random_recording(1))
    return path


def test_a_recording_becomes_a_page_figures_and_a_bag(recording):
    folder = recording.parent
    said = make("player", f"RECORDING={recording}")
    assert said.split() == [str(folder / "recording.html")]
    assert (folder / "recording.html").stat().st_size > 100_000
    said = make("figures", f"RECORDING={recording}", f"OUT={folder / 'figures'}")
    drawn = {path.name for path in (folder / "figures").iterdir()}
    assert {"plane.png", "buses.pdf"} <= drawn and {
        Path(line).name for line in said.split()
    } == drawn
    said = make("bag", f"RECORDING={recording}", f"OUT={folder / 'bag'}")
    assert said.split() == [str(folder / "bag")]
    assert (folder / "bag" / "metadata.yaml").exists()


@pytest.mark.parametrize("command", ["player", "figures", "bag"])
def test_a_recording_that_is_missing_is_named(command, tmp_path):
    missing = tmp_path / "missing.npz"
    said = make(command, f"RECORDING={missing}", f"OUT={tmp_path / 'out'}", fails=True)
    assert str(missing) in said


@pytest.fixture(scope="module")
def plane(new_domain, tmp_path_factory):
    """The domain of a plane of 30 robots that `make console` runs."""
    domain = new_domain()
    out = tmp_path_factory.mktemp("live")
    command = ["make", "-o", "build/.built", "console", "ROBOTS=30", "PORT=0", f"OUT={out}"]
    live = subprocess.Popen(
        command, cwd=ROOT, env=_environment(domain), stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True,
        # as a shell starts a job in the background: it must end at an interrupt all the same
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )  # fmt: skip
    for line in live.stdout:
        if line.startswith("console: http://127.0.0.1:"):
            break
    else:
        pytest.fail(live.stderr.read())
    yield domain
    os.killpg(live.pid, signal.SIGINT)  # as Ctrl-C does
    _, said = live.communicate(timeout=60)
    assert "interrupted, all nodes were ended" in said and "Traceback" not in said
    assert list(out.glob("plan-*.npz"))


def test_a_running_plane_is_taken_to_targets_shown_and_changed(plane):
    said = make("reconfigure", "TARGETS=random:1", domain=plane)
    assert re.search(r"^reached +ok +30$", said, re.MULTILINE), said
    said = make("show", "TOPIC=layout", domain=plane)
    assert len(said.splitlines()) > 30
    said = make("disable", "IDS=3 17", "WHY=slips", domain=plane)
    assert "3" in said and "17" in said
    said = make("disable", domain=plane)
    assert "17" in said and "slips" in said
    make("enable", "IDS=3 17", domain=plane)
    assert "slips" not in make("enable", domain=plane)
    assert "99" in make("disable", "IDS=99", domain=plane, fails=True)
