# SPDX-License-Identifier: Apache-2.0
"""Drives: how motors carry out their orders, and the curves that the joints then follow."""

from fiber_core.drive.breaches import Breaches, MotorRule
from fiber_core.drive.curves import CurveMotion, carried_out
from fiber_core.drive.drive import Drive
from fiber_core.drive.listed import ListedSpeeds
from fiber_core.drive.power import most_motors_on, motors_allowed, motors_turning, overloading
from fiber_core.drive.rules import rules_broken

__all__ = [
    "Breaches",
    "CurveMotion",
    "Drive",
    "ListedSpeeds",
    "MotorRule",
    "carried_out",
    "most_motors_on",
    "motors_allowed",
    "motors_turning",
    "overloading",
    "rules_broken",
]
