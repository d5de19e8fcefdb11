# SPDX-License-Identifier: Apache-2.0
"""Bus traffic as files for other tools: VCD waveforms and pcap packets."""

from fiber_bus_bridge.capture.pcap import write_pcap
from fiber_bus_bridge.capture.tap import Tap
from fiber_bus_bridge.capture.vcd import write_vcd
from fiber_bus_bridge.capture.waveform import Waveform, waveform

__all__ = ["Tap", "Waveform", "waveform", "write_pcap", "write_vcd"]
