# SPDX-License-Identifier: Apache-2.0
"""Recordings of plans: the values, the file, and how they are built from the frames on the buses.

No module that this file imports needs ROS. The recorder (`node`), `bag` and `settled_replay` do.
"""

from fiber_recording.build_recording import build_recording
from fiber_recording.closest import closest_approaches
from fiber_recording.errors import BagError, RecordingError
from fiber_recording.images import Images
from fiber_recording.phases import Phase, counts_at, executed_motion
from fiber_recording.recording import (
    SOFTWARE,
    Approaches,
    BusLoad,
    EventKind,
    Events,
    Measured,
    Recording,
)
from fiber_recording.recording_file import load_recording, save_recording
from fiber_recording.replay import Replay, replay, unexplained

__all__ = [
    "SOFTWARE",
    "Approaches",
    "BagError",
    "BusLoad",
    "EventKind",
    "Events",
    "Images",
    "Measured",
    "Phase",
    "Recording",
    "RecordingError",
    "Replay",
    "build_recording",
    "closest_approaches",
    "counts_at",
    "executed_motion",
    "load_recording",
    "replay",
    "save_recording",
    "unexplained",
]
