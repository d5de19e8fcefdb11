# SPDX-License-Identifier: Apache-2.0
"""Ramps of motors: in CONFIG, and checked by robots."""

from dataclasses import replace

import numpy as np
import pytest

from fiber_bus_bridge import Session, addresses_of
from fiber_bus_bridge.errors import WireError
from fiber_bus_bridge.simulation import SimulationConfig, simulated_buses
from fiber_bus_bridge.wire import (
    Addresses,
    Configuration,
    Fault,
    Ramps,
    Speeds,
    decode_config,
    encode_config,
)
from fiber_core.clearance import Safety
from fiber_core.drive import Drive
from fiber_core.drive.named import with_drive
from fiber_core.presets import preset
from fiber_core.wire_units import WireUnits

N = 5
LISTED, ANY = (with_drive(preset("desi_petals", N), name) for name in ("desi", "accelerated"))
UNITS = WireUnits.for_plane(LISTED)
RAMP_US = {"desi": [22_000, 0], "accelerated": [round(1e6 * ANY.drive.ramp_s)]}


def configuration(plane):
    limits, speed = UNITS.range_counts(plane), np.full((N, 2), 8000)
    lists, ramps = Speeds.of(plane, UNITS), Ramps.of(plane)
    return Configuration(UNITS, limits, speed, 1000, listed=lists, ramps=ramps)


@pytest.mark.parametrize("plane", [LISTED, ANY], ids=["listed", "any speed"])
def test_ramps_travel_in_the_configuration_and_come_back(plane):
    to = addresses_of(plane)
    frames = encode_config(configuration(plane), to)
    for row in range(N):
        config = decode_config(frames.payload(row), int(to.address[row]), bool(to.ten_bit[row]))
        told = config.ramps.content.reshape(-1).view(">u4")
        assert told.tolist() == RAMP_US[plane.drive.name]


def test_robots_without_ramps_are_told_of_none():
    plane = preset("desi_petals", N)
    assert Ramps.of(plane) is None
    to = addresses_of(plane)
    frames = encode_config(configuration(plane), to)
    config = decode_config(frames.payload(0), int(to.address[0]), bool(to.ten_bit[0]))
    assert config.ramps is None


@pytest.mark.parametrize("plane", [LISTED, ANY], ids=["listed", "any speed"])
def test_robots_keep_the_ramps_that_they_were_told(plane):
    config = SimulationConfig(preset="desi_petals", robots=N)
    start = plane.limits.mean(axis=2)
    buses = simulated_buses(plane, UNITS, start, config)
    session = Session(plane, UNITS, Safety(), buses, start)
    session.configure(0.0)
    assert session.known.all()
    memory, k = buses.positioners.memory, len(RAMP_US[plane.drive.name])
    assert (memory["ramp_bytes"] == 4 * k).all()
    told = np.ascontiguousarray(memory["ramps"][:, : 4 * k]).view(">u4")
    assert (told == RAMP_US[plane.drive.name]).all()


@pytest.mark.parametrize(
    ("plane", "change", "fault"),
    [
        (LISTED, lambda x: x[:-4], Fault.BAD_LENGTH),  # one ramp of two speeds
        (ANY, lambda x: [*x, 0, 0, 0, 0], Fault.BAD_LENGTH),
        (ANY, lambda x: [0, 0, 0, 0], Fault.BAD_VALUE),  # no ramp is no block
        (LISTED, lambda x: [0, 1, 0, 0, *x[4:]], Fault.BAD_VALUE),  # longer than the rest behind
        (LISTED, lambda x: [*x[:7], 1], Fault.BAD_VALUE),
    ],
)
def test_ramps_that_do_not_fit_the_motors_are_refused(plane, change, fault):
    to = Addresses([0], [300], [True])
    one = replace(
        configuration(plane),
        limits=UNITS.range_counts(plane)[:1],
        speed=np.full((1, 2), 8000),
        listed=None if plane is ANY else Speeds.of(plane, UNITS)[:1],
        ramps=Ramps.of(plane)[:1],
    )
    body = encode_config(one, to).payload(0)[:-2]
    content = one.ramps.content[0].tolist()
    assert body.endswith(bytes([3, len(content), *content]))
    changed = change(content)
    wrong = replace(one, ramps=Ramps(np.array([changed], dtype=np.uint8)))
    with pytest.raises(WireError) as error:
        decode_config(encode_config(wrong, to).payload(0), 300, True)
    assert error.value.fault == fault


def test_a_ramp_of_a_part_of_a_microsecond_is_refused_with_its_value():
    plane = replace(ANY, drive=Drive(N, ramp_s=0.0220004, name="odd"))
    with pytest.raises(WireError, match=r"'odd' has a ramp of 0.0220004 s"):
        Ramps.of(plane)
