# SPDX-License-Identifier: Apache-2.0
"""Two example recordings: one that ran to its end, and one that was stopped and resumed."""

import pytest

from fiber_recording import Recording, save_recording
from fiber_recording.examples import random_recording


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
