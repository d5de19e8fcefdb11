# SPDX-License-Identifier: Apache-2.0
"""The outlines with which plans are made and certified, where arms are not where counters say."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fiber_bus_bridge.errors import BridgeError
from fiber_bus_bridge.measured_places import learn_intervals, widen_outlines
from fiber_bus_bridge.node.publishers import Publishers
from fiber_bus_bridge.session import Session
from fiber_bus_bridge.session_state import SessionState
from fiber_core.arm_bounds import arms_within, interval_of_tips
from fiber_core.array_types import Floats
from fiber_core.bounds import Range, check_ranges
from fiber_core.focal_plane import FocalPlane

__all__ = ["BlindErrors", "Outlines"]


@dataclass(frozen=True)
class BlindErrors:
    """How far fibres are from where their counters say, in and after a blind move.

    Args:
        blind_um: error of one coordinate of a fibre, 1 sigma [um], beyond what the drive of the
            plane tells (`uncertainty_rad` and lost motion are in every certificate without it);
            0 for robots that are where their counters say.
        blind_sigmas: errors at which the interval of a robot ends.

    Raises:
        BridgeError: a value is out of range; names it.
    """

    RANGES: ClassVar = {"blind_um": Range(0.0, 1e5), "blind_sigmas": Range(0.0, 10.0)}

    blind_um: float = 0.0
    blind_sigmas: float = 2.0

    def __post_init__(self) -> None:
        check_ranges(self, self.RANGES, BridgeError)


class Outlines:
    """Grows the outlines of a session by what is not known of its arms.

    In a blind move they hold what the last image left unknown and the error of the drive; in a
    correction the former alone, if an image was taken since the last blind move. Between plans they
    are those of a blind move.

    Args:
        session: the session with the robots.
        exact: the plane with outlines as they are.
        errors: errors of blind moves.
        outgoing: publishes the layout.
    """

    def __init__(
        self, session: Session, exact: FocalPlane, errors: BlindErrors, outgoing: Publishers
    ):
        self._session, self._exact, self._outgoing = session, exact, outgoing
        half_rad = interval_of_tips(exact, errors.blind_sigmas * errors.blind_um * 1e-3)
        self._blind_mm = np.stack(arms_within(exact, half_rad), axis=1)
        session.protocol.of_move_mm = self._blind_mm
        session.protocol.blind_mm = self._blind_mm  # no image was taken yet
        self._grown_mm: Floats = np.zeros((exact.n, 2))
        self._seen = False  # whether an image was taken since the last blind move

    @property
    def known_mm(self) -> Floats:
        """What the last image left unknown, also one of an earlier session [mm], shape (n, 2)."""
        return self._session.protocol.known_mm

    def use(self, straight: bool) -> None:
        """Grow the outlines for a plan; publish the layout if they change.

        Args:
            straight: whether it is a correction.

        Raises:
            SessionError: they would change, and robots move, are stopped or have orders.
        """
        if not straight:
            self.move_blind()
        self._wear(straight)

    def move_blind(self) -> None:
        """Forget that an image was taken: the arms move, and no image tells where they end."""
        self._seen, self._session.protocol.blind_mm = False, self._blind_mm

    def rest(self) -> None:
        """Grow the outlines for a blind move, unless orders wait, robots move or are stopped.

        The next targets are drawn with outlines that a blind move needs.
        """
        if self._session.state is SessionState.IDLE:
            self._wear(straight=False)

    def learn(self, known_mm: Floats) -> None:
        """Take over how far points of the outlines may be from where the counters put them.

        Args:
            known_mm: bounds for the theta and the phi outline [mm], shape (n, 2).

        Raises:
            SessionError: robots move, are stopped or have orders, or a bound is negative or
                infinite.
        """
        self._grow(known_mm, straight=False)
        self._seen = True
        learn_intervals(self._session, *known_mm.T)

    def _wear(self, straight: bool) -> None:
        if self._grow(self.known_mm, straight and self._seen):
            self._outgoing.publish_layout(always=True)

    def _grow(self, known_mm: Floats, straight: bool) -> bool:
        # errors of the image and of the drive know nothing of each other
        wider_mm = known_mm if straight else np.hypot(known_mm, self._blind_mm)
        if np.array_equal(wider_mm, self._grown_mm):
            return False
        widen_outlines(self._session, self._exact, *wider_mm.T)
        self._grown_mm = wider_mm
        return True
