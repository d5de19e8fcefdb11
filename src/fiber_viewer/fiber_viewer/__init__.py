"""Recordings of a focal plane's reconfigurations, and pictures of them."""

from fiber_viewer.closest import closest_approaches
from fiber_viewer.errors import RecordingError
from fiber_viewer.figures import before_and_after
from fiber_viewer.legs import Leg, counts_at, executed
from fiber_viewer.page import write_player
from fiber_viewer.recording import (
    Approaches,
    BusLoad,
    EventKind,
    Events,
    Measured,
    Recording,
)
from fiber_viewer.recording_file import load_recording, save_recording

__all__ = [
    "SOFTWARE",
    "Approaches",
    "BusLoad",
    "EventKind",
    "Events",
    "Leg",
    "Measured",
    "Recording",
    "RecordingError",
    "before_and_after",
    "closest_approaches",
    "counts_at",
    "executed",
    "load_recording",
    "save_recording",
    "write_player",
]

SOFTWARE = "fiber_viewer 0.1.0"  # what a recording says it was written by
