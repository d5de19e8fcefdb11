# SPDX-License-Identifier: Apache-2.0
"""Why motors do not let robots move as they were told to: arrays, and sentences made of them."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Codes, Floats, Ids, Ints, Mask
from fiber_core.drive.drive import Drive

__all__ = ["Breaches", "MotorRule"]

_JOINTS = ("theta", "phi")


class MotorRule(IntEnum):
    """A rule that an order, or a goal, would break; with the unit of its value."""

    LISTED_SPEED = 1  # speed of the motor [rad/s]
    LEAST_MOVE = 2  # turn of the motor [rad], at least the least one of its speed
    RAMP = 3  # rest after a move [s], at least its ramp
    APPROACH = 4  # last move back or forth [rad], as far as the approach its way
    WHOLE_UNITS = 5  # speed of a joint [rad/s] that is not whole units of wire and list
    ACCELERATION = 6  # of a joint [rad/s2]
    SUPPLY = 7  # motors of a supply that turn at once, were the robot to move
    APPROACH_BEGIN = 8  # angle at which the approach to a goal begins [rad]
    JOINT_SPEED = 9  # of a joint [rad/s]
    JOINT_RANGE = 10  # angle of a joint on its way [rad]
    ORDER_LENGTH = 11  # end of the motion of a joint [s]


@dataclass(frozen=True, eq=False)
class Breaches:
    """Rules of motors that orders break, one entry for each joint or robot and rule.

    Args:
        robot: row of the robot, shape (k,).
        joint: 0 theta, 1 phi; -1 where it is of both, shape (k,).
        rule: MotorRule, shape (k,).
        value: what is asked of the motor, in the unit of the rule, shape (k,).
        least, most: what the motor allows, in the same unit; -inf and inf without a limit; nan
            where it is not one interval, shape (k,).
    """

    robot: Ints
    joint: Ints
    rule: Codes
    value: Floats
    least: Floats
    most: Floats

    @classmethod
    def of(
        cls,
        rule: ArrayLike,
        where: ArrayLike,
        value: ArrayLike,
        least: ArrayLike = -np.inf,
        most: ArrayLike = np.inf,
    ) -> Self:
        """Return entries of joints or robots that break a rule.

        Args:
            rule: the rule, one for all or of the shape of `where`.
            where: joints, shape (n, 2) of bool, or robots, shape (n,).
            value, least, most: as in the class; each broadcasts to the shape of `where`.
        """
        mask = np.asarray(where, dtype=np.bool_)
        at = np.argwhere(mask)
        columns = [np.broadcast_to(x, mask.shape)[mask] for x in (rule, value, least, most)]
        joint = at[:, 1] if mask.ndim == 2 else np.full(len(at), -1)
        return cls(at[:, 0], joint, columns[0].astype(np.int64), *columns[1:])

    @classmethod
    def none(cls) -> Self:
        """Return no entry."""
        return cls.of(MotorRule.LISTED_SPEED, np.zeros(0, dtype=np.bool_), 0.0)

    @classmethod
    def joined(cls, parts: "Iterable[Breaches]") -> Self:
        """Return the entries of all parts, in order of the robots' rows."""
        parts = [cls.none(), *parts]
        names = [each.name for each in fields(cls)]
        columns = [np.concatenate([getattr(part, name) for part in parts]) for name in names]
        order = np.argsort(columns[0], kind="stable")
        return cls(*(column[order] for column in columns))

    def __len__(self) -> int:
        """Number of entries."""
        return len(self.robot)

    def of_rows(self, rows: ArrayLike) -> "Breaches":
        """Return the entries of robots that are rows of a larger plane, shape (m,), there."""
        return replace(self, robot=np.asarray(rows, dtype=np.int64)[self.robot])

    def robots(self, n: int) -> Mask:
        """Return which of n robots have an entry, shape (n,)."""
        mask = np.zeros(n, dtype=np.bool_)
        mask[self.robot] = True
        return mask

    def told(self, drive: Drive, supply: ArrayLike, ids: Ids) -> list[str]:
        """Return a sentence for each entry, with id and value.

        Args:
            drive: the drive of the n robots.
            supply: number of the supply of each robot, shape (n,).
            ids: their ids, shape (n,).
        """
        return [
            f"robot {ids[self.robot[k]]}: {self.text(drive, supply, k)}" for k in range(len(self))
        ]

    def text(self, drive: Drive, supply: ArrayLike, k: int) -> str:
        """Return the sentence of entry k without the id of its robot."""
        i, joint, rule = int(self.robot[k]), int(self.joint[k]), MotorRule(self.rule[k])
        own = tuple(float(column[k]) for column in (self.value, self.least, self.most))
        if rule == MotorRule.SUPPLY:
            group = np.asarray(supply)
            return (
                f"its motors are too many for supply {group[i]}, which feeds {own[2]:.0f} of its "
                f"{2 * (group == group[i]).sum()} motors at once"
            )
        x, least, most = np.rad2deg(own)
        listed = drive.listed
        speeds = np.rad2deg([] if listed is None else listed.speeds_rad_s)
        sign = 0.0 if listed is None else listed.approach_sign[joint]
        goal = x + sign * (0.0 if listed is None else np.rad2deg(listed.approach_rad[joint]))
        return {
            MotorRule.LISTED_SPEED: f"{_JOINTS[joint]} is to turn its motor at {x:.4g} deg/s, "
            f"listed are {', '.join(f'{each:.4g}' for each in speeds)} deg/s",
            MotorRule.LEAST_MOVE: f"{_JOINTS[joint]} is to turn its motor by {x:.4g} deg, at this "
            f"speed at least {least:.4g} deg",
            MotorRule.RAMP: f"{_JOINTS[joint]} rests for {own[0]:.4g} s after a ramp of "
            f"{own[1]:.4g} s began",
            MotorRule.APPROACH: f"{_JOINTS[joint]} ends with a move of {x:.4g} deg, its approach "
            f"is {least if np.isfinite(least) else -most:.4g} deg in creep",
            MotorRule.WHOLE_UNITS: f"{_JOINTS[joint]} is to turn at up to {x:.4g} deg/s, and not "
            f"for whole ticks at a listed speed",
            MotorRule.ACCELERATION: f"{_JOINTS[joint]} is to change its speed by "
            f"{x * drive.ramp_s:.4g} deg/s within its ramp of {drive.ramp_s:.4g} s, at {x:.4g} "
            f"deg/s2; its motor does {most:.4g} deg/s2 at most",
            MotorRule.APPROACH_BEGIN: f"the approach of {_JOINTS[joint]} to {goal:.4g} deg begins "
            f"at {x:.4g} deg, its range is {least:.4g} to {most:.4g} deg",
            MotorRule.JOINT_SPEED: f"{_JOINTS[joint]} is to turn at {x:.4g} deg/s, at most "
            f"{most:.4g} deg/s are allowed",
            MotorRule.JOINT_RANGE: f"{_JOINTS[joint]} is to go to {x:.4g} deg, its range is "
            f"{least:.4g} to {most:.4g} deg",
            MotorRule.ORDER_LENGTH: f"{_JOINTS[joint]} is to move until {own[0]:.4g} s, an order "
            f"lasts {own[2]:.4g} s at most",
        }[rule]
