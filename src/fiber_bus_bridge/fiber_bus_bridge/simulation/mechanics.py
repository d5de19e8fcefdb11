# SPDX-License-Identifier: Apache-2.0
"""Mechanical errors of the joints: what keeps a true arm from the angle that its counter reads."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fiber_bus_bridge.errors import BridgeError
from fiber_core import bounds
from fiber_core.array_types import Angles, Floats, Ints, Mask
from fiber_core.validation import frozen_array

__all__ = ["NEVER", "MechanicalErrors", "Mechanics", "draw_mechanics"]

NEVER = 2**62  # number of a movement that no robot reaches
_ROUNDING = 1e-9
_WAVES = 3  # sines of the non-linearity that are drawn


@dataclass(frozen=True, eq=False)
class Mechanics:
    """Errors of each joint of n robots; joint 0 is theta, 1 phi. A robot knows none of them.

    The gear of a joint turns as its counter does, but: scaled by direction, without the share that
    slips, with a speed error that is new for each segment, not at all while the joint sticks, and
    no further than its stops. At each reversal the gear turns through the backlash before the
    arm follows. The arm stands at ``y + sum_k wave_k sin(k y + phase_k)``, y the angle after that.

    Movements of a robot are counted from 0.

    Args:
        scale: angle of the gear over angle of the counter, shape (n, 2, 2): robot, joint, towards
            lower and towards higher angles.
        backlash_rad: lost motion at a reversal [rad], shape (n, 2).
        slack_rad: the part of the backlash that a motion towards higher angles has taken up
            before the first movement [rad], shape (n, 2).
        wave_rad: amplitudes of 1, 2, ... periods a turn [rad], shape (n, 2, w).
        phase_rad: their phases [rad], shape (n, 2, w).
        still_in: the movement in which a joint sticks: it does not turn, and the counter counts
            as if it did; NEVER for none, shape (n, 2).
        stuck_from: the movement from which on a joint never turns again, shape (n, 2).
        slip: largest share of a movement that slips; each movement loses a random share up to it,
            shape (n, 2).
        speed_noise: rms relative error of the speed, new for each segment, shape (n, 2).
        stops_rad: lowest and highest angle of the gear at hard stops [rad], shape (n, 2, 2).
        seed: seed of slip and speed noise.

    Raises:
        BridgeError: a shape does not fit or a value is out of range; names row and value.
    """

    scale: Floats
    backlash_rad: Angles
    slack_rad: Angles
    wave_rad: Floats
    phase_rad: Floats
    still_in: Ints
    stuck_from: Ints
    slip: Floats
    speed_noise: Floats
    stops_rad: Floats
    seed: int = 0

    _RANGES: ClassVar = {
        "scale": (0.0, 10.0, (2, 2)),
        "backlash_rad": (0.0, 1.0, (2,)),
        "slack_rad": (0.0, 1.0, (2,)),
        "wave_rad": (-0.1, 0.1, (2, None)),
        "phase_rad": (-10.0, 10.0, (2, None)),
        "slip": (0.0, 1.0, (2,)),
        "speed_noise": (0.0, 0.2, (2,)),
        "stops_rad": (-np.inf, np.inf, (2, 2)),
    }

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.scale))
        for name, (low, high, shape) in self._RANGES.items():
            value = frozen_array(getattr(self, name), np.float64, (n, *shape), name, BridgeError)
            _refuse(~((value >= low) & (value <= high)), name, value, f"{low:g} to {high:g}")
            object.__setattr__(self, name, value)
        for name in ("still_in", "stuck_from"):
            value = frozen_array(getattr(self, name), np.int64, (n, 2), name, BridgeError)
            _refuse(value < 0, name, value, "0 or more")
            object.__setattr__(self, name, value)
        bounds.check_number(self.seed, "seed", 0, 2**63 - 1, BridgeError, whole=True)
        _refuse(self.slack_rad > self.backlash_rad, "slack_rad", self.slack_rad, "<= backlash_rad")
        low, high = np.moveaxis(self.stops_rad, -1, 0)
        _refuse(~(low <= high), "stops_rad", self.stops_rad, "low <= high")
        if self.wave_rad.shape != self.phase_rad.shape:
            raise BridgeError(
                f"wave_rad has shape {self.wave_rad.shape}, phase_rad {self.phase_rad.shape}"
            )
        # the arm must turn the same way as its gear: the slope 1 + sum k wave_k cos stays positive
        periods = 1 + np.arange(self.wave_rad.shape[2])
        steep = (np.abs(self.wave_rad) * periods).sum(axis=2)
        _refuse(steep >= 1.0, "wave_rad", self.wave_rad, "a slope below 1")

    @property
    def n(self) -> int:
        """Number of robots."""
        return len(self.scale)

    @property
    def sticking(self) -> Mask:
        """Robots with a joint that does not turn in some movement, shape (n,)."""
        first = np.minimum(self.still_in, self.stuck_from)
        return np.asarray((first < NEVER).any(axis=1))

    @classmethod
    def ideal(cls, n: int) -> "Mechanics":
        """Return the mechanics of n robots whose arms stand where their counters read."""
        none = np.zeros((n, 2))
        wave = np.zeros((n, 2, 0))
        never = np.full((n, 2), NEVER)
        stops = np.broadcast_to([-np.inf, np.inf], (n, 2, 2))
        return cls(np.ones((n, 2, 2)), none, none, wave, wave, never, never, none, none, stops)

    def with_(self, **changes: ArrayLike) -> "Mechanics":
        """Return the same mechanics with some arrays replaced.

        Raises:
            BridgeError: as the class.
        """
        return replace(self, **changes)  # type: ignore[arg-type]


def _refuse(bad: ArrayLike, name: str, value: np.ndarray, rule: str) -> None:
    bad = np.asarray(bad)
    if bad.any():
        row = int(np.argwhere(bad)[0][0])
        raise BridgeError(f"robot row {row}: {name} must be {rule}, got {value[row].tolist()}")


@dataclass(frozen=True)
class MechanicalErrors:
    """Sizes of the errors of a plane, from which those of each joint are drawn.

    Args:
        scale: rms relative error of the scale, by joint and direction.
        backlash_deg: largest lost motion at a reversal [deg]; uniform from 0.
        wave_deg: rms amplitude of each of three sines of the non-linearity [deg].
        speed_noise: rms relative error of the speed of each segment.
        non_movers: share of the robots with a joint, or both, that sticks in the first movement
            and reports that it moved.
        stuck: share of the robots with a joint that is stuck for good.
        slipping: share of the robots with a joint that slips.
        slip: largest share of a movement that a slipping joint loses.
        stop_deg: how far hard stops are beyond the ranges of the joints, if these are told [deg].

    Raises:
        BridgeError: a value is out of range; names it. The shares of non_movers, stuck and slipping
            are of different robots, so that their sum is 1 at most.
    """

    RANGES: ClassVar = {
        "scale": bounds.Range(0.0, 0.1),
        "backlash_deg": bounds.Range(0.0, 5.0),
        "wave_deg": bounds.Range(0.0, 1.0),
        "speed_noise": bounds.Range(0.0, 0.05),
        "non_movers": bounds.Range(0.0, 1.0),
        "stuck": bounds.Range(0.0, 1.0),
        "slipping": bounds.Range(0.0, 1.0),
        "slip": bounds.Range(0.0, 1.0),
        "stop_deg": bounds.Range(0.0, 360.0),
    }

    scale: float = 0.0
    backlash_deg: float = 0.0
    wave_deg: float = 0.0
    speed_noise: float = 0.0
    non_movers: float = 0.0
    stuck: float = 0.0
    slipping: float = 0.0
    slip: float = 0.3
    stop_deg: float = 1.0

    def __post_init__(self) -> None:
        bounds.check_ranges(self, self.RANGES, BridgeError)
        shares = self.non_movers + self.stuck + self.slipping
        if shares > 1.0 + _ROUNDING:
            raise BridgeError(
                f"non_movers {self.non_movers}, stuck {self.stuck} and slipping {self.slipping} "
                f"are shares of different robots: their sum must be 1 at most, got {shares:g}"
            )


def draw_mechanics(
    n: int,
    errors: MechanicalErrors,
    rng: np.random.Generator,
    ranges: ArrayLike | None = None,
) -> Mechanics:
    """Draw the mechanics of n robots.

    Args:
        n: number of robots.
        errors: sizes of the errors.
        rng: source of randomness; the same state gives the same mechanics.
        ranges: ranges of the joints [rad], shape (n, 2, 2), beyond which there are hard stops; None
            for joints without stops.
    """
    backlash = rng.uniform(0.0, np.deg2rad(errors.backlash_deg), (n, 2))
    # the amplitude stays within the range of Mechanics, and the slope within half
    amplitude = np.clip(rng.normal(size=(n, 2, _WAVES)), -4.0, 4.0) * np.deg2rad(errors.wave_deg)
    scale = 1.0 + errors.scale * np.clip(rng.normal(size=(n, 2, 2)), -5.0, 5.0)
    slack, phase = rng.uniform(0.0, backlash), rng.uniform(-np.pi, np.pi, (n, 2, _WAVES))
    joints = _defects(n, errors, rng)
    ideal = Mechanics.ideal(n)
    stops = ideal.stops_rad
    if ranges is not None:
        stops = np.asarray(ranges) + np.deg2rad(errors.stop_deg) * np.array([-1.0, 1.0])
    return ideal.with_(
        scale=scale,
        backlash_rad=backlash,
        slack_rad=slack,
        wave_rad=amplitude,
        phase_rad=phase,
        still_in=np.where(joints[0], 0, NEVER),
        stuck_from=np.where(joints[1], 0, NEVER),
        slip=np.where(joints[2], errors.slip, 0.0),
        speed_noise=np.full((n, 2), errors.speed_noise),
        stops_rad=stops,
        seed=np.asarray(rng.integers(2**62)).item(),
    )


def _defects(n: int, errors: MechanicalErrors, rng: np.random.Generator) -> np.ndarray:
    """Joints that stick, are stuck and slip, shape (3, n, 2); a robot has one defect at most."""
    shares = (errors.non_movers, errors.stuck, errors.slipping)
    order, first = rng.permutation(n), 0
    joints = np.zeros((3, n, 2), dtype=bool)
    for kind, share in enumerate(shares):
        rows = order[first : first + round(share * n)]
        first += len(rows)
        which = rng.integers(4, size=len(rows))  # theta, phi, or twice as often both
        joints[kind, rows, 0] = which != 1
        joints[kind, rows, 1] = which != 0
    return joints
