# SPDX-License-Identifier: Apache-2.0
"""The cases of a study: instruments and planners over a grid of parameters."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.presets import PRESETS, plane_from, preset
from fiber_formats import DEFAULT_PRESET
from fiber_planner import DEFAULT_PLANNER
from fiber_positioners.problems import random_problem
from fiber_positioners.reconfiguration import reconfigure

__all__ = ["Case", "Row", "grid", "study_rows"]

_ROBOTS = 300
Row: TypeAlias = dict[str, object]  # the parameters of a field, its seed and its results
_RESULTS = (
    "asked", "reached", "held", "failed", "makespan_s", "lower_bound_s", "makespan_ratio",
    "segments_mean", "segments_max", "bytes_mean", "certified", "min_clearance_mm",
)  # fmt: skip


@dataclass(frozen=True)
class Case:
    """One instrument and one planner of a study; figures that are None are those of the preset.

    Args:
        preset: the instrument that lends all other figures.
        robots: number of robots.
        pitch_mm: distance between neighbours [mm].
        arms_mm: lengths of theta arm and phi arm [mm].
        radius_mm: half width of the phi arm [mm].
        disabled: share of robots that are disabled, 0..1.
        planner: name of the planner.
    """

    preset: str = DEFAULT_PRESET
    robots: int = _ROBOTS
    pitch_mm: float | None = None
    arms_mm: tuple[float, float] | None = None
    radius_mm: float | None = None
    disabled: float = 0.0
    planner: str = DEFAULT_PLANNER

    def check(self) -> None:
        """Refuse an impossible figure.

        Raises:
            FiberError: the preset is unknown, or a figure is out of range; says which.
        """
        if self.preset not in PRESETS:
            raise FiberError(f"no preset is named {self.preset!r}; there are {', '.join(PRESETS)}")
        if PRESETS[self.preset].build is not None:
            raise FiberError(
                f"preset {self.preset} is no plain grid of equal robots, which a study varies"
            )
        lengths = {"pitch": self.pitch_mm, "radius": self.radius_mm}
        lengths |= dict(zip(("theta arm", "phi arm"), self.arms_mm or ()))
        for name, value in lengths.items():
            if value is not None and not value > 0:
                raise FiberError(f"{name} must be positive, got {value:g} mm")
        if self.robots < 1:
            raise FiberError(f"robots must be a positive integer, got {self.robots}")
        if not 0.0 <= self.disabled < 1.0:
            raise FiberError(f"the share of disabled robots must be in 0..1, got {self.disabled:g}")
        if self.arms_mm is not None and not isinstance(PRESETS[self.preset].phi_outline, str):
            raise FiberError(
                f"the outlines of preset {self.preset} do not scale with its arms: vary the arms "
                "of another preset"
            )

    def plane(self, rng: np.random.Generator) -> FocalPlane:
        """Return the focal plane, with the disabled robots drawn from a generator.

        Raises:
            FiberError: a figure is impossible; says which.
        """
        self.check()
        figures = PRESETS[self.preset]
        base = preset(self.preset, self.robots)
        pitch = figures.pitch_mm if self.pitch_mm is None else self.pitch_mm
        radius = figures.radius_mm if self.radius_mm is None else self.radius_mm
        # random targets of narrow arms may be closer to each other than those of wide ones
        wider = radius / figures.radius_mm if figures.radius_mm else 1.0
        figures = replace(
            figures,
            pitch_mm=pitch,
            arms_mm=self.arms_mm or figures.arms_mm,
            radius_mm=radius,
            envelope_mm=wider * figures.envelope_mm,
        )
        centers = base.centers * (pitch / PRESETS[self.preset].pitch_mm)
        plane = plane_from(figures, base.ids, centers, name=self.preset)
        if self.disabled:
            plane = plane.with_enabled(rng.random(plane.n) >= self.disabled)
        return plane

    def columns(self) -> dict[str, object]:
        """Return all parameters as plain values by name, the figures of the preset filled in."""
        figures = PRESETS[self.preset]
        arms = self.arms_mm or figures.arms_mm
        return {
            "preset": self.preset,
            "robots": self.robots,
            "pitch_mm": figures.pitch_mm if self.pitch_mm is None else self.pitch_mm,
            "arm_theta_mm": arms[0],
            "arm_phi_mm": arms[1],
            "radius_mm": figures.radius_mm if self.radius_mm is None else self.radius_mm,
            "disabled": self.disabled,
            "planner": self.planner,
        }

    def run(self, seed: int) -> Row:
        """Draw one field, carry it out, and return its row of results.

        A field that cannot be drawn has `error` in place of results: arms too long for the
        pitch leave no place for all robots.
        """
        row: Row = {**self.columns(), "seed": seed}
        try:
            rng = np.random.default_rng(seed)
            problem = random_problem(self.plane(rng), rng)
            report = reconfigure(problem, planner=self.planner, seed=seed).report
        except FiberError as error:
            return row | dict.fromkeys(_RESULTS) | {"error": str(error)}
        return row | {name: report[name] for name in _RESULTS} | {"error": ""}

    def __str__(self) -> str:
        arms = "x".join(f"{length:g}" for length in self.arms_mm or ())
        named = (
            ("", self.preset),
            ("robots ", f"{self.robots}"),
            ("pitch ", None if self.pitch_mm is None else f"{self.pitch_mm:g}"),
            ("arms ", arms or None),
            ("radius ", None if self.radius_mm is None else f"{self.radius_mm:g}"),
            ("disabled ", f"{self.disabled:g}" if self.disabled else None),
            ("", self.planner),
        )
        return ", ".join(f"{name}{value}" for name, value in named if value is not None)


def grid(
    *,
    preset: Sequence[str] = (DEFAULT_PRESET,),
    robots: Sequence[int] = (_ROBOTS,),
    pitch_mm: Sequence[float | None] = (None,),
    arms_mm: Sequence[tuple[float, float] | None] = (None,),
    radius_mm: Sequence[float | None] = (None,),
    disabled: Sequence[float] = (0.0,),
    planner: Sequence[str] = (DEFAULT_PLANNER,),
) -> tuple[Case, ...]:
    """Return a case for every combination of the values; the last parameter varies fastest."""
    values = (preset, robots, pitch_mm, arms_mm, radius_mm, disabled, planner)
    return tuple(Case(*combination) for combination in itertools.product(*values))


def study_rows(cases: Sequence[Case], seeds: Sequence[int]) -> Iterator[tuple[Case, Row]]:
    """Carry out a field for every case and seed; yield case and row as soon as each is done."""
    for case in cases:
        for seed in seeds:
            yield case, case.run(seed)
