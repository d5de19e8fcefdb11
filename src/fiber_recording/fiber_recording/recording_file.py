# SPDX-License-Identifier: Apache-2.0
"""Writes and reads recordings: one .npz file of plain arrays, which numpy and a browser can read.

The file has the arrays of a problem.npz under the same names, so it can be opened as a problem,
too. Long smooth series are stored as differences in small whole numbers, which compress well: a
trajectory as steps of a microradian, encoder readings as their distance from the orders.
docs/recording.md lists every array. Two prefixes are older than the names used in the code:
`leg_` is a phase, and `margin_` is a corridor.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fiber_core.corridor import JointCorridors
from fiber_core.drive import carried_out, motors_turning
from fiber_core.errors import FiberError
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Outcome, Reason
from fiber_core.problem import problem_columns, problem_of
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_recording.errors import RecordingError
from fiber_recording.images import Images
from fiber_recording.phases import Phase, counts_at
from fiber_recording.recording import (
    Approaches,
    BusLoad,
    EventKind,
    Events,
    Measured,
    Recording,
)

__all__ = ["FORMAT", "VERSION", "load_recording", "save_recording"]

FORMAT = "fiber recording"
VERSION = 2
_PLANNED_STEP_RAD = 1e-6  # to which planned angles are rounded
_MOTOR_BINS = 400  # in which the motors that turn at once are counted
_CORRIDOR_STEP_RAD = 1e-3  # to which corridors are rounded, inwards
_ENUMERATIONS = {"outcome": Outcome, "reason": Reason, "event": EventKind}
_EVENT_COLUMNS = {"time_s": "<f8", "kind": "u1", "bus": "<i4", "row": "<i4", "detail": "<i4"}

_Columns = Mapping[str, NDArray[Any]]  # the arrays of a file, of various types, by name


def save_recording(path: Path, recording: Recording) -> None:
    """Write a recording to a file; a failure leaves no incomplete file at `path`.

    Args:
        path: the file, its name should end in .npz.
        recording: the recording.

    Raises:
        OSError: the file cannot be written.
    """
    partial = path.with_name(path.name + ".part")
    with open(partial, "wb") as file:
        # the stub takes every array for its argument allow_pickle
        np.savez_compressed(file, **_columns(recording))  # pyright: ignore[reportArgumentType]
    partial.replace(path)


def _columns(recording: Recording) -> dict[str, NDArray[Any]]:
    about = recording.about | {
        "format": FORMAT,
        "version": VERSION,
        "names": {
            key: {int(code): code.name.lower() for code in codes}
            for key, codes in _ENUMERATIONS.items()
        },
        "units": asdict(recording.units),
        "bus_begin_s": recording.load.begin_s,
        "bus_bin_s": recording.load.bin_s,
    }
    if recording.images is not None:
        about["names"]["verdict"] = dict(recording.images.names)
    phases, measured = recording.phases, recording.measured
    off = measured.counts - counts_at(phases, measured.row, measured.time_us)
    sizes = np.cumsum([0] + [len(phase.motion.ticks) for phase in phases])
    columns = problem_columns(recording.problem) | {
        "about": np.frombuffer(json.dumps(about).encode(), np.uint8),
        "start_counts": recording.motion.start.astype("<i4"),
        "offsets": np.stack([phase.motion.offsets + s for phase, s in zip(phases, sizes)]).astype(
            "<i4"
        ),
        "ticks": np.concatenate([phase.motion.ticks for phase in phases]).astype("<i4"),
        "velocity": np.concatenate([phase.motion.velocity for phase in phases]).astype("<i4"),
        "leg_begin_us": np.array([phase.begin_us for phase in phases], "<i4"),
        "leg_stop_us": np.stack([phase.stop_us for phase in phases]).astype("<i4"),
        "leg_stop_counts": np.stack([phase.stop_counts for phase in phases]).astype("<i4"),
        "started": recording.started,
        "outcome": recording.outcome.astype("u1"),
        "reason": recording.reason.astype("u1"),
        "error_mm": recording.error_mm,
        "measured_row": measured.row.astype("<i4"),
        "measured_step_us": _differences(measured.time_us),
        "measured_off_counts": off.astype("<i4"),
        "bus_id": recording.load.buses.astype("<i4"),
        "bus_frames": recording.load.frames.astype("<i4"),
        "bus_bytes": recording.load.bytes.astype("<i4"),
        "pair_row": recording.approaches.pairs.astype("<i4"),
        "pair_gap_mm": recording.approaches.gap_mm.astype("<f4"),
        "pair_time_s": recording.approaches.time_s.astype("<f4"),
    }
    for name, kind in _EVENT_COLUMNS.items():
        columns[f"event_{name}"] = getattr(recording.events, name).astype(kind)
    if recording.planned is not None:
        columns["planned_time_s"] = recording.planned.time_s
        columns["planned_step_urad"] = _differences(
            np.rint(recording.planned.angles / _PLANNED_STEP_RAD)
        )
    if recording.corridors is not None:
        corridors = recording.corridors
        bounds = [
            np.ceil(corridors.low / _CORRIDOR_STEP_RAD),
            np.floor(corridors.high / _CORRIDOR_STEP_RAD),
        ]
        columns["margin_lasts_s"] = corridors.lasts_s.astype("<f4")
        columns["margin_step_mrad"] = _differences(np.stack(bounds, axis=2), "<i2")
    return columns | _image_columns(recording.images) | _motor_columns(recording)


def _image_columns(images: Images | None) -> dict[str, NDArray[Any]]:
    if images is None:
        return {}
    columns: dict[str, NDArray[Any]] = {
        "image_place_mm": images.place_mm.astype("<f4"),
        "image_verdict": images.verdict.astype("u1"),
    }
    if images.true_mm is not None:
        columns["image_true_mm"] = images.true_mm.astype("<f4")
    return columns


def _motor_columns(recording: Recording) -> dict[str, NDArray[Any]]:
    """How many motors of each supply turn at once, for a plane with a cap on them."""
    plane = recording.problem.plane
    if plane.drive.motors_on == 1.0:
        return {}
    motion = carried_out(plane.drive, recording.executed)
    edges_s = np.linspace(0.0, max(motion.makespan_s, 1e-3), _MOTOR_BINS + 1)
    supplies, robots = np.unique(plane.supply, return_counts=True)
    return {
        "supply_id": supplies.astype("<i4"),
        "supply_motors": (2 * robots).astype("<i4"),
        "supply_turning": motors_turning(motion, plane.supply, edges_s).astype("<i4"),
        "supply_bin_s": np.array(edges_s[1]),
    }


def _differences(values: NDArray[Any], kind: str = "<i4") -> NDArray[Any]:
    """The first value and the differences of all others from the ones before them."""
    steps = np.diff(values.astype(np.int64), axis=-1, prepend=0)
    return np.ascontiguousarray(steps.astype(kind))


def load_recording(path: Path) -> Recording:
    """Read a recording of this or an older version.

    Args:
        path: the file.

    Raises:
        RecordingError: the file is not a recording, its version is newer than this software, or
            a value in it does not fit; names the file and the value.
    """
    data = _read(path)
    about = _about(data["about"], path)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return _recording(data, about, str(path))
    except KeyError as missing:
        raise RecordingError(f"{path} has no array or value {missing}") from None
    except FiberError as error:
        raise RecordingError(f"{path}: {error}") from None
    except (
        ArithmeticError,
        AttributeError,
        IndexError,
        MemoryError,
        TypeError,
        ValueError,
    ) as error:
        # numpy's words for an array of another type or shape than this software writes
        raise RecordingError(f"{path} is damaged: {error}") from None


def _about(text: NDArray[Any], path: Path) -> dict[str, Any]:
    try:
        about = json.loads(bytes(text))
    except (RecursionError, TypeError, ValueError) as error:
        raise RecordingError(f"{path} is not a recording: about is not JSON: {error}") from None
    kind = about.get("format") if isinstance(about, dict) else about
    if kind != FORMAT:
        raise RecordingError(f"{path} is not a recording: its format is {kind!r}")
    version = about.get("version")
    if not isinstance(version, int):
        raise RecordingError(f"{path} is damaged: its version is {version!r}")
    if version > VERSION:
        raise RecordingError(
            f"{path} has version {version}, this software reads versions up to {VERSION}: "
            "use a newer release"
        )
    return about


def _read(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path) as file:
            data = dict(file)
    except Exception as error:  # zipfile, zlib and numpy raise errors of a dozen types
        text = str(error) or type(error).__name__
        raise RecordingError(f"{path} is not a recording: {text}") from None
    if "about" not in data:
        raise RecordingError(f"{path} is not a recording: it has no array 'about'")
    return data


def _recording(data: _Columns, about: dict[str, Any], name: str) -> Recording:
    units = WireUnits(**about.pop("units"))
    phases = _phases(data, units)
    row, time_us = data["measured_row"], np.cumsum(data["measured_step_us"], dtype=np.int64)
    counts = counts_at(phases, row, time_us) + data["measured_off_counts"]
    planned = None
    if "planned_time_s" in data:
        angles = np.cumsum(data["planned_step_urad"], axis=-1, dtype=np.int64) * _PLANNED_STEP_RAD
        planned = SampledMotion(data["planned_time_s"], angles)
    images = _images(data, about)
    for key in ("format", "version", "names"):  # they describe the file
        del about[key]
    begin_s, bin_s = about.pop("bus_begin_s"), about.pop("bus_bin_s")
    load = BusLoad(data["bus_id"], begin_s, bin_s, data["bus_frames"], data["bus_bytes"])
    return Recording(
        problem=problem_of(data, name),
        units=units,
        phases=phases,
        started=data["started"],
        planned=planned,
        corridors=_corridors(data),
        measured=Measured(row, time_us, counts),
        load=load,
        events=Events(**{name: data[f"event_{name}"] for name in _EVENT_COLUMNS}),
        outcome=data["outcome"],
        reason=data["reason"],
        error_mm=data["error_mm"],
        approaches=Approaches(data["pair_row"], data["pair_gap_mm"], data["pair_time_s"]),
        about=about,
        images=images,
    )


def _images(data: _Columns, about: dict[str, Any]) -> Images | None:
    if "image_place_mm" not in data:
        return None
    names = {int(code): name for code, name in about["names"]["verdict"].items()}
    places, verdict = data["image_place_mm"], data["image_verdict"]
    return Images(places, verdict, data.get("image_true_mm"), names)


def _phases(data: _Columns, units: WireUnits) -> tuple[Phase, ...]:
    # version 1 has one phase, and its orders are cut where robots were stopped
    offsets, start = np.atleast_2d(data["offsets"]), data["start_counts"]
    phases = []
    for k, own in enumerate(offsets):
        part = slice(own[0], own[-1])
        motion = WireMotion(units, start, own - own[0], data["ticks"][part], data["velocity"][part])
        phase = Phase.whole(motion)
        if "leg_begin_us" in data:
            begin_us = int(data["leg_begin_us"][k])
            phase = Phase(motion, begin_us, data["leg_stop_us"][k], data["leg_stop_counts"][k])
        phases.append(phase)
        start = phase.end
    return tuple(phases)


def _corridors(data: _Columns) -> JointCorridors | None:
    if "margin_lasts_s" not in data:
        return None
    bounds = _CORRIDOR_STEP_RAD * np.cumsum(data["margin_step_mrad"], axis=-1, dtype=np.int64)
    low, high = bounds[:, :, 0], bounds[:, :, 1]
    # rounding inwards can put the low bound above the high one: then the corridor is one angle
    return JointCorridors(data["margin_lasts_s"], np.minimum(low, high), high)
