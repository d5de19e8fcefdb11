# SPDX-License-Identifier: Apache-2.0
"""Waveforms as VCD for PulseView, GTKWave and sigrok."""

from collections.abc import Iterable
from typing import TextIO

import numpy as np

from fiber_bus_bridge.bus import BusTiming, Exchange
from fiber_bus_bridge.capture.waveform import waveform

__all__ = ["write_vcd"]

_FAST_HZ = 1.2e6  # above this clock, 10 ns are too coarse for the minimum times


def write_vcd(file: TextIO, exchanges: Iterable[Exchange], timing: BusTiming) -> int:
    """Write SDA and SCL of every bus from the first message on; return the number of edges.

    Signals are `SDAn` and `SCLn` of bus n, in steps of 10 ns, in High-speed mode of 1 ns.

    Args:
        file: file opened for text.
        exchanges: the traffic on the buses.
        timing: clock and times of every bus.

    Raises:
        ModuleNotFoundError: pyvcd is not installed.
    """
    from vcd import VCDWriter

    wave = waveform(exchanges, timing)
    step_ns = 10 if timing.clock_hz < _FAST_HZ else 1
    begin_s = wave.time_s[0] - 10e-6 if len(wave.time_s) else 0.0
    steps = np.rint((wave.time_s - begin_s) * 1e9 / step_ns).astype(np.int64)
    with VCDWriter(file, timescale=f"{step_ns} ns", date="", comment="I2C buses") as writer:
        lines = {
            (bus, line): writer.register_var("i2c", f"{name}{bus}", "wire", size=1, init=1)
            for bus in np.unique(wave.bus).tolist()
            for line, name in enumerate(("SDA", "SCL"))
        }
        columns = (column.tolist() for column in (steps, wave.bus, wave.line, wave.level))
        for at, bus, line, level in zip(*columns):
            writer.change(lines[bus, line], at, level)
        if len(steps):
            writer.close(int(steps[-1]) + 1000)
    return len(steps)
