# SPDX-License-Identifier: Apache-2.0
"""Two example recordings: one that ran to its end, and one that was stopped and resumed."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fiber_viewer
from fiber_recording import Recording, save_recording
from fiber_recording.examples import random_recording
from fiber_viewer import write_player

sys.path.append(str(Path(__file__).parent))  # for the modules that tests share
from chromium import open_at, size, start_browser  # noqa: E402

PLAYER = Path(fiber_viewer.__file__).parent / "player"


@pytest.fixture(scope="session")
def recording() -> Recording:
    return random_recording(1)


@pytest.fixture(scope="session")
def resumed() -> Recording:
    """All robots were stopped on the way; all but the failed one were resumed."""
    return random_recording(2, interrupted=True)


@pytest.fixture(scope="session")
def recording_file(recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "recording.npz"
    save_recording(path, recording)
    return path


@pytest.fixture(scope="session")
def resumed_file(resumed, tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "resumed.npz"
    save_recording(path, resumed)
    return path


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    driver = start_browser(tmp_path_factory.mktemp("profile"))
    yield driver
    driver.quit()


@pytest.fixture(scope="session")
def page(recording_file, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "player.html"
    write_player(path, recording_file)
    return path


@pytest.fixture
def opened(browser, page):
    """A browser with the page, newly opened and drawn."""
    size(browser, 1440, 1000)
    open_at(browser, page, "")
    return browser


@pytest.fixture
def node(tmp_path):
    """Run a script with `recording` and `inputs`, and return the value of its `answer`."""
    if shutil.which("node") is None:
        pytest.skip("NOT TESTED: the scripts of the page, because node is not installed")

    def run(recording_file, body, **inputs):
        (tmp_path / "inputs.json").write_text(json.dumps(inputs))
        imports = "".join(
            f"import * as {name} from {json.dumps((PLAYER / f'{name}.js').as_uri())};\n"
            for name in ("recording", "kinematics", "clearance", "neighbourhood", "profiles")
            + ("address", "headline", "axes", "phases", "images")
        )
        (tmp_path / "run.mjs").write_text(
            imports.replace("* as recording", "* as opened")
            + f"""
            import fs from "node:fs";
            const inputs = JSON.parse(fs.readFileSync({json.dumps(str(tmp_path / "inputs.json"))}));
            const bytes = new Uint8Array(fs.readFileSync({json.dumps(str(recording_file))}));
            const recording = await opened.openRecording(bytes);
            let answer;
            {body}
            console.log(JSON.stringify(answer));
            """
        )
        ran = subprocess.run(
            ["node", tmp_path / "run.mjs"], capture_output=True, text=True, check=False
        )
        assert ran.returncode == 0, ran.stderr
        return json.loads(ran.stdout)

    return run
