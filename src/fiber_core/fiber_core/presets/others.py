# SPDX-License-Identifier: Apache-2.0
"""The plane of the papers, MOONS and LAMOST: equal robots on a hexagonal grid."""

from fiber_core.presets.figures import Preset

__all__ = ["LAMOST", "MOONS", "PAPER"]

PAPER = Preset(
    robots=5167,
    pitch_mm=12.0,
    arms_mm=(3.0, 3.0),
    theta_deg=(-1440.0, 1440.0),
    phi_deg=(-1440.0, 1440.0),
    speeds_deg_s=(180.0, 120.0),
    envelope_mm=4.0,
    radius_mm=1.0,
    phi_outline="tip",
    hexagon=True,
    note="A&A 566 A84. Pitch inferred from its Fig. 7, arms from its text. It keeps only "
    "tips apart (discs of d = 2 mm) and has no joint stops: four turns either way "
    "stand for none.",
)

MOONS = Preset(
    robots=1006,
    pitch_mm=25.3,
    arms_mm=(8.0, 17.0),
    theta_deg=(-180.0, 180.0),
    phi_deg=(-180.0, 150.0),
    speeds_deg_s=(16.7, 22.5),
    envelope_mm=10.5,
    radius_mm=2.625,
    note="The highest speeds of the ranges quoted. A capsule as wide as the widest part of "
    "the beta arm (5.25 mm), without its 0.5 mm of safety. Envelope chosen: four radii.",
)

LAMOST = Preset(
    robots=4000,
    pitch_mm=25.6,
    arms_mm=(8.25, 8.25),
    theta_deg=(-180.0, 180.0),
    phi_deg=(0.0, 180.0),
    speeds_deg_s=(180.0, 180.0),
    envelope_mm=8.0,
    radius_mm=2.0,
    note="Arms inferred. Joint ranges, speeds and arm width are assumed, none is known: "
    "the least ranges that reach the whole disc, half a turn a second, the width of an "
    "SDSS-V arm. Envelope chosen: four radii.",
)
