"""A recording as one .npz file: standard arrays that numpy, a browser or anything else reads.

The arrays of a problem.npz are in it under the same names, so it opens as one of those
too. What is long and smooth is kept as small whole numbers, which deflate well: planned
curves as steps of a microradian, encoder readings as their distance from the orders.
docs/recording.md names every array.
"""

import json
import zipfile
from dataclasses import asdict

import numpy as np

from fiber_core.errors import FiberError
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Outcome, Reason
from fiber_core.problem import problem_columns, problem_of
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_viewer.recording import (
    Approaches,
    BusLoad,
    EventKind,
    Events,
    Measured,
    Recording,
    RecordingError,
)

__all__ = ["FORMAT", "VERSION", "load_recording", "ordered_counts", "save_recording"]

FORMAT = "fiber recording"
VERSION = 1
_PLANNED_RAD = 1e-6  # planned angles are rounded to this
_NAMES = {"outcome": Outcome, "reason": Reason, "event": EventKind}
_EVENTS = {"time_s": "<f8", "kind": "u1", "bus": "<i4", "row": "<i4", "detail": "<i4"}


def save_recording(path, recording: Recording) -> None:
    """Write a recording; the file is complete or not there.

    Args:
        path: where, as pathlib.Path; should end in .npz.
        recording: what.
    """
    partial = path.with_name(path.name + ".part")
    with open(partial, "wb") as file:
        np.savez_compressed(file, **_columns(recording))
    partial.replace(path)


def _columns(recording):
    about = recording.about | {
        "format": FORMAT,
        "version": VERSION,
        "names": {
            key: {int(code): code.name.lower() for code in codes} for key, codes in _NAMES.items()
        },
        "units": asdict(recording.units),
        "bus_begin_s": recording.load.begin_s,
        "bus_bin_s": recording.load.bin_s,
    }
    motion, measured = recording.motion, recording.measured
    off = measured.counts - ordered_counts(motion, measured.row, measured.time_us)
    columns = problem_columns(recording.problem) | {
        "about": np.frombuffer(json.dumps(about).encode(), np.uint8),
        "start_counts": motion.start.astype("<i4"),
        "offsets": motion.offsets.astype("<i4"),
        "ticks": motion.ticks.astype("<i4"),
        "velocity": motion.velocity.astype("<i4"),
        "started": recording.started,
        "outcome": recording.outcome.astype("u1"),
        "reason": recording.reason.astype("u1"),
        "error_mm": recording.error_mm,
        "measured_row": measured.row.astype("<i4"),
        "measured_step_us": _steps(measured.time_us),
        "measured_off_counts": off.astype("<i4"),
        "bus_id": recording.load.buses.astype("<i4"),
        "bus_frames": recording.load.frames.astype("<i4"),
        "bus_bytes": recording.load.bytes.astype("<i4"),
        "pair_row": recording.approaches.pairs.astype("<i4"),
        "pair_gap_mm": recording.approaches.gap_mm.astype("<f4"),
        "pair_time_s": recording.approaches.time_s.astype("<f4"),
    }
    for name, kind in _EVENTS.items():
        columns[f"event_{name}"] = getattr(recording.events, name).astype(kind)
    if recording.planned is not None:
        columns["planned_time_s"] = recording.planned.time_s
        columns["planned_step_urad"] = _steps(np.rint(recording.planned.angles / _PLANNED_RAD))
    return columns


def _steps(values):
    # from each value to the next, the first as it is
    steps = np.diff(values.astype(np.int64), axis=-1, prepend=0)
    return np.ascontiguousarray(steps.astype("<i4"))


def ordered_counts(motion: WireMotion, row, time_us) -> np.ndarray:
    """Return where orders put robots at some times, in whole numbers only [quanta], (m, 2).

    Args:
        motion: the orders.
        row: robots, shape (m,).
        time_us: times from the GO on [us], shape (m,).
    """
    profile = 2 * np.asarray(row, dtype=np.int64)[:, None] + [0, 1]
    left = np.repeat(np.maximum(np.asarray(time_us, dtype=np.int64), 0)[:, None], 2, axis=1)
    counts = motion.start.ravel()[profile]
    segment, stop = motion.offsets[profile], motion.offsets[profile + 1]
    tick_us = motion.units.tick_us
    while (inside := segment < stop).any():
        at = np.where(inside, segment, 0)
        spent = np.where(inside, np.minimum(left, motion.ticks[at] * tick_us), 0)
        counts = counts + np.where(inside, motion.velocity[at] * spent // tick_us, 0)
        left, segment = left - spent, segment + 1
    return counts


def load_recording(path) -> Recording:
    """Read a recording of this or an older version.

    Raises:
        RecordingError: the file is no recording, is newer than this software, or a value
            in it does not fit; names it.
    """
    data = _read(path)
    about = json.loads(bytes(data["about"]))
    if about.get("format") != FORMAT:
        raise RecordingError(f"{path} is no recording")
    if about["version"] > VERSION:
        raise RecordingError(
            f"{path} is of version {about['version']}, this software reads up to {VERSION}"
        )
    try:
        return _recording(data, about, str(path))
    except KeyError as missing:
        raise RecordingError(f"{path} has no {missing}") from None
    except FiberError as error:
        raise RecordingError(f"{path}: {error}") from None


def _read(path):
    try:
        with np.load(path) as file:
            data = dict(file)
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as reason:
        raise RecordingError(f"{path} is no recording: {reason}") from None
    if "about" not in data:
        raise RecordingError(f"{path} is no recording: it does not say what it is")
    return data


def _recording(data, about, name) -> Recording:
    units = WireUnits(**about.pop("units"))
    motion = WireMotion(
        units, data["start_counts"], data["offsets"], data["ticks"], data["velocity"]
    )
    row, time_us = data["measured_row"], np.cumsum(data["measured_step_us"], dtype=np.int64)
    counts = ordered_counts(motion, row, time_us) + data["measured_off_counts"]
    planned = None
    if "planned_time_s" in data:
        angles = np.cumsum(data["planned_step_urad"], axis=-1, dtype=np.int64) * _PLANNED_RAD
        planned = SampledMotion(data["planned_time_s"], angles)
    for key in ("format", "version", "names"):  # of the file, not of what it tells
        del about[key]
    begin_s, bin_s = about.pop("bus_begin_s"), about.pop("bus_bin_s")
    load = BusLoad(data["bus_id"], begin_s, bin_s, data["bus_frames"], data["bus_bytes"])
    return Recording(
        problem=problem_of(data, name),
        units=units,
        motion=motion,
        started=data["started"],
        planned=planned,
        measured=Measured(row, time_us, counts),
        load=load,
        events=Events(**{name: data[f"event_{name}"] for name in _EVENTS}),
        outcome=data["outcome"],
        reason=data["reason"],
        error_mm=data["error_mm"],
        approaches=Approaches(data["pair_row"], data["pair_gap_mm"], data["pair_time_s"]),
        about=about,
    )
