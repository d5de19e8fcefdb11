# SPDX-License-Identifier: Apache-2.0
"""What coordinator and sectors tell each other: each message says all, so that any may be lost."""

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from fiber_sectors.errors import SectorError

__all__ = ["Beat", "Order", "Report", "Stage", "decode_beat", "decode_report", "encode_beat",
           "encode_report"]  # fmt: skip

_BEAT = struct.Struct("<4sqqBdH")
_ANSWER = struct.Struct("<qdd")
_REPORT = struct.Struct("<4sHqqBdddd")
_BEAT_MARK, _REPORT_MARK = b"FSB1", b"FSR1"
_MOST_S = 1e10  # clocks count from 1970 or from the last boot


class Order(IntEnum):
    """What a beat lets the sectors do."""

    WAIT = 0  # load and verify, and wait
    GO = 1  # count down to the start, and do not move yet
    MOVE = 2  # a lease: move, or begin to
    STOP = 3


class Stage(IntEnum):
    """How far a sector is in a run."""

    LOADING = 0
    READY = 1  # its orders are loaded and verified
    COUNTING = 2  # all its robots count down
    MOVING = 3
    ENDED = 4  # all its robots have arrived, or none was started
    STOPPED = 5


@dataclass(frozen=True)
class Beat:
    """One message of the coordinator to all sectors.

    Args:
        run: number of the run, which rises.
        number: number of the beat in its run, from 1.
        order: what the sectors may do.
        sent_s: time of the coordinator [s].
        boots: for each sector the boot of the report that is answered, 0 for none.
        answers_s: for each sector the time of that report, on its clock [s].
        starts_s: for each sector the instant of the start, on its clock [s]; nan without.
    """

    run: int
    number: int
    order: Order
    sent_s: float
    boots: tuple[int, ...]
    answers_s: tuple[float, ...]
    starts_s: tuple[float, ...]


@dataclass(frozen=True)
class Report:
    """One message of a sector to the coordinator.

    Args:
        sector: number of the sector.
        boot: names this process of the sector; another one has another number.
        run: number of the run.
        stage: how far the sector is.
        sent_s: time of the sector [s].
        beat_s: time, on the clock of the coordinator, of the newest beat heard [s]; nan for none.
        heard_s: time at which it was heard, on the clock of the sector [s].
        start_s: instant of its start, on its clock [s]; nan before the countdown.
    """

    sector: int
    boot: int
    run: int
    stage: Stage
    sent_s: float
    beat_s: float
    heard_s: float
    start_s: float


def encode_beat(beat: Beat) -> bytes:
    """Return the bytes of a beat."""
    head = _BEAT.pack(
        _BEAT_MARK, beat.run, beat.number, beat.order, beat.sent_s, len(beat.answers_s)
    )
    columns = zip(beat.boots, beat.answers_s, beat.starts_s)
    return b"".join([head, *(_ANSWER.pack(*row) for row in columns)])


def decode_beat(data: bytes) -> Beat:
    """Return the beat in some bytes.

    Raises:
        SectorError: the bytes are no beat.
    """
    _check(data, _BEAT_MARK, _BEAT.size, "beat")
    _, run, number, order, sent_s, sectors = _BEAT.unpack_from(data)
    if len(data) != _BEAT.size + sectors * _ANSWER.size or order not in tuple(Order):
        raise SectorError(f"{len(data)} bytes with order {order} are no beat to {sectors} sectors")
    rows: Sequence[tuple[int, float, float]] = list(_ANSWER.iter_unpack(data[_BEAT.size :]))
    boots, answers_s, starts_s = (tuple(each) for each in zip(*rows)) if rows else ((), (), ())
    _check_numbers("beat", run, number, *boots)
    _check_times("beat", (sent_s,), (*answers_s, *starts_s))
    return Beat(run, number, Order(order), sent_s, boots, answers_s, starts_s)


def encode_report(report: Report) -> bytes:
    """Return the bytes of a report."""
    return _REPORT.pack(
        _REPORT_MARK, report.sector, report.boot, report.run, report.stage, report.sent_s,
        report.beat_s, report.heard_s, report.start_s,
    )  # fmt: skip


def decode_report(data: bytes) -> Report:
    """Return the report in some bytes.

    Raises:
        SectorError: the bytes are no report.
    """
    _check(data, _REPORT_MARK, _REPORT.size, "report")
    _, sector, boot, run, stage, *times = _REPORT.unpack(data)
    if stage not in tuple(Stage):
        raise SectorError(f"a report with stage {stage}: there is none")
    sent_s, beat_s, heard_s, start_s = times
    _check_numbers("report", boot, run)
    _check_times("report", (sent_s,), (beat_s, heard_s, start_s))
    if math.isnan(beat_s) != math.isnan(heard_s):
        raise SectorError(f"a report of a beat of {beat_s:g} s, heard at {heard_s:g} s")
    return Report(sector, boot, run, Stage(stage), *times)


def _check(data: bytes, mark: bytes, least: int, name: str) -> None:
    exact = name == "report" and len(data) != least
    if len(data) < least or exact or data[: len(mark)] != mark:
        raise SectorError(f"{len(data)} bytes that begin with {data[:4]!r} are no {name}")


def _check_numbers(name: str, *numbers: int) -> None:
    if min(numbers) < 0:
        raise SectorError(f"a {name} with the number {min(numbers)}")


def _check_times(name: str, known_s: Sequence[float], may_be_unknown_s: Sequence[float]) -> None:
    """Refuse times that are not finite; some may be nan."""
    for time_s in (*known_s, *(each for each in may_be_unknown_s if not math.isnan(each))):
        if not abs(time_s) <= _MOST_S:
            raise SectorError(f"a {name} with the time {time_s:g} s")
