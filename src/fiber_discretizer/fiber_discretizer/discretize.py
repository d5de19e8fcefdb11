"""From a planned trajectory to certified orders: the whole way, in the order of the paper."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fiber_core.clearance import Certificate, Safety, hold_until_safe
from fiber_core.focal_plane import FocalPlane
from fiber_core.motion import SampledMotion
from fiber_core.outcomes import Reason
from fiber_core.wire_units import WireMotion, WireUnits
from fiber_discretizer.draft import Draft
from fiber_discretizer.hold import hold_on_samples
from fiber_discretizer.intake import check_trajectory, starting_counts
from fiber_discretizer.options import DiscretizeOptions

__all__ = ["Discretization", "discretize"]


@dataclass(frozen=True, eq=False)
class Discretization:
    """What is sent, and the proof that it is safe.

    Args:
        wire: the motion in whole wire units; robots with a reason other than OK rest.
        reason: Reason of each robot, shape (n,): OK, BAD_TRAJECTORY, DISABLED,
            TOO_MANY_SEGMENTS or UNSAFE.
        certificate: certificate of wire.decoded() over the whole plane. It is not ok
            only where robots at rest are too close already.
        rounds: how often margins were tightened.
    """

    wire: WireMotion
    reason: np.ndarray
    certificate: Certificate
    rounds: int


def discretize(
    plane: FocalPlane,
    trajectory: SampledMotion,
    units: WireUnits,
    safety: Safety,
    start_counts=None,
    options: DiscretizeOptions | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Discretization:
    """Turn a planned trajectory into few constant-velocity segments that are proven safe.

    The seven steps of the paper (Makarem et al. 2014, SPIE, arXiv 1410.1181) as they are
    understood here: planned trajectory; margin of the first motor; its profile
    linearized; margin of the second motor from the first motor's new profile; its
    profile linearized; both in wire units; checked. Added: robots whose trajectories
    meet are held first, and those whose decoded motion cannot be certified are done
    again with tighter margins, then held.

    Args:
        plane: the focal plane.
        trajectory: joint profiles of all its robots.
        units: size of tick and quantum, and the widths of the fields.
        safety: gap asked for and timing errors to survive.
        start_counts: where the robots are [quanta], shape (n, 2); by default at the
            start of the trajectory.
        options: how it is done, by default as DiscretizeOptions says.
        progress: told now and then the part of the work done (0..1) and a few words.

    Raises:
        MotionError: trajectory or start_counts do not fit the plane.
    """
    options = options or DiscretizeOptions()
    tell = progress or (lambda part, words: None)
    tell(0.0, "checking the trajectory")
    start_counts = starting_counts(plane, trajectory, units, start_counts)
    reason = check_trajectory(
        plane, trajectory, start_counts, units, options.start_tolerance_rad, options.speed_tolerance
    )
    draft = Draft(plane, trajectory, start_counts, units, safety, options)

    def give_up(robots, why):
        reason[robots] = why
        draft.rest(robots)

    draft.rest(reason != Reason.OK)
    tell(0.1, "holding robots whose trajectories meet")
    give_up(hold_on_samples(draft.free_space), Reason.UNSAFE)
    todo = draft.moving
    tightness = np.ones(plane.n)
    rounds = 0
    while todo.any():
        tell(0.2 + 0.6 * rounds / (options.rounds + 1), f"discretizing {todo.sum()} robots")
        give_up(draft.redo(todo, tightness), Reason.TOO_MANY_SEGMENTS)
        todo = draft.unsafe(todo) & draft.moving
        if rounds == options.rounds or not todo.any():
            break
        rounds += 1
        tightness[todo] *= 0.5 if rounds < options.rounds else 0.0

    tell(0.8, "certifying")
    _, held, certificate = hold_until_safe(plane, draft.wire.decoded(), safety)
    give_up(held, Reason.UNSAFE)
    tell(1.0, "certified" if certificate.ok else "robots at rest are too close")
    reason.setflags(write=False)
    return Discretization(draft.wire, reason, certificate, rounds)
