# SPDX-License-Identifier: Apache-2.0
"""One focal plane on many hosts: the agreement by which its sectors start and stop together."""

from fiber_sectors.clock_fit import ClockFit, Offset
from fiber_sectors.conductor import Conductor, Step
from fiber_sectors.errors import SectorError
from fiber_sectors.member import Decision, Member
from fiber_sectors.messages import (
    Beat,
    Order,
    Report,
    Stage,
    decode_beat,
    decode_report,
    encode_beat,
    encode_report,
)
from fiber_sectors.terms import Terms

__all__ = [
    "Beat",
    "ClockFit",
    "Conductor",
    "Decision",
    "Member",
    "Offset",
    "Order",
    "Report",
    "SectorError",
    "Stage",
    "Step",
    "Terms",
    "decode_beat",
    "decode_report",
    "encode_beat",
    "encode_report",
]
