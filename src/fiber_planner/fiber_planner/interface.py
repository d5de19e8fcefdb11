"""What every planner takes and gives."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from fiber_core.motion import SampledMotion
from fiber_core.problem import Problem
from fiber_planner.errors import PlannerError

__all__ = ["PlannedMotion", "Planner", "Progress"]

# Called now and then with the part of the work done (0..1) and a few words about it.
Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """How every robot of a plane should move, where it was meant to end, and whether it does.

    Args:
        motion: joint profiles of all robots of the plane; those not moving are constant.
        goal: configuration each robot aims at [rad], shape (n, 2); its start where
            nothing is asked of it or nothing can be done for it.
        reason: fiber_core.outcomes.Reason of each robot, shape (n,): OK (it arrives),
            NO_TARGET, GOAL_BLOCKED, NOT_CONVERGED, TANGLED, or why it cannot be moved.
        tangled: pairs that start closer than they may come, rows a < b of robots and
            obstacles, shape (k, 2); the plan never brings them closer.

    Raises:
        PlannerError: the shapes do not belong to the same plane.
    """

    motion: SampledMotion
    goal: np.ndarray
    reason: np.ndarray
    tangled: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self):
        n = self.motion.n
        for name, dtype, shape in (
            ("goal", float, (n, 2)),
            ("reason", np.int64, (n,)),
            ("tangled", np.int64, (len(self.tangled), 2)),
        ):
            value = np.array(getattr(self, name), dtype=dtype, order="C")
            if value.shape != shape:
                raise PlannerError(f"{name} has shape {value.shape}, expected {shape}")
            value.setflags(write=False)
            object.__setattr__(self, name, value)


class Planner(Protocol):
    """Anything that turns a reconfiguration problem into a motion."""

    name: str

    def plan(self, problem: Problem, progress: Progress | None = None) -> PlannedMotion:
        """Plan the motion of every robot from its start to its target.

        Args:
            problem: the plane, where its robots are, where their fibres should go.
            progress: told now and then how far the work is.
        """
        ...
