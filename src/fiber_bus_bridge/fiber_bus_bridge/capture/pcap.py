# SPDX-License-Identifier: Apache-2.0
"""Messages as packets of link type 209 (I2C Linux) for Wireshark."""

import struct
from collections.abc import Iterable
from typing import BinaryIO

import numpy as np

from fiber_bus_bridge.bus import Exchange
from fiber_bus_bridge.capture.waveform import wire_bytes

__all__ = ["write_pcap"]

_MAGIC_NANOSECONDS, _LINK_TYPE = 0xA1B23C4D, 209
_NO_FLAGS = 0


def write_pcap(file: BinaryIO, exchanges: Iterable[Exchange]) -> int:
    """Write one packet for each START, in order of time; return the number of packets.

    A packet is the bus number (seven bits), four bytes of flags, the address bytes and the
    data, as libpcap defines it. Messages without bytes on the wire are left out. A message that
    was not acknowledged ends at the byte without acknowledge.

    Args:
        file: file opened for bytes.
        exchanges: the traffic on the buses.
    """
    file.write(struct.pack("<IHHiIII", _MAGIC_NANOSECONDS, 2, 4, 0, 0, 65535, _LINK_TYPE))
    packets = []
    for exchange in exchanges:
        for row in range(len(exchange.frames)):
            for number, part in enumerate(wire_bytes(exchange, row)):
                body = bytes(int(byte) for byte, _ in part)
                bus = int(exchange.frames.to.bus[row]) & 0x7F
                packets.append((exchange.replies.start_s[row], number, bus, body))
    begin_s = np.floor(min((p[0] for p in packets), default=0.0))
    for at, _, bus, body in sorted(packets, key=lambda packet: packet[:3]):
        seconds, nanoseconds = divmod(round((at - begin_s) * 1e9), 10**9)
        size = 5 + len(body)
        file.write(struct.pack("<IIII", seconds, nanoseconds, size, size))
        file.write(struct.pack(">BI", bus, _NO_FLAGS) + body)
    return len(packets)
