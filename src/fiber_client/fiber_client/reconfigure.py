"""Take a running focal plane to new targets: send them, follow, start, wait, print what came of it.

TARGETS is a table (.csv, .ecsv, .fits) with columns id, x_mm, y_mm, a problem.npz, or
random[:SEED] for targets that all enabled robots can take at once, drawn for the plane
that is running. Progress, rates and alerts go to stderr, the result to stdout: a table, or
with --json one line with the outcomes, when each stage was done, what the buses carried,
and all alerts. Exit code 0 says that the motion ran and each robot asked reached its
target or is held with a reason; anything else is 1.
"""

import argparse
import json
import sys

import numpy as np
from rclpy.utilities import remove_ros_args

from fiber_client.client import PlaneClient
from fiber_client.errors import PlaneError
from fiber_client.terminal import ProgressDisplay, table
from fiber_core.errors import FiberError
from fiber_core.fields import random_field
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_core.tables import read_targets
from fiber_msgs_py import PlanStamp, topics
from fiber_node.ros_environment import use_loopback

__all__ = ["count_outcomes", "main", "summary", "went_well"]

_SHOWN = 5  # robots not reached that are named
_NOT_RUN = (Reason.STOPPED, Reason.NOT_PLANNED)


def main(argv=None) -> int:
    """Run one reconfiguration from the command line."""
    argv = remove_ros_args(sys.argv if argv is None else ["reconfigure", *argv])[1:]
    options = _parser().parse_args(argv)
    use_loopback()
    with ProgressDisplay() as display:
        try:
            with PlaneClient(on_progress=display, on_status=display.status) as client:
                return _run(client, options, display)
        except FiberError as error:
            display.say(f"reconfigure: {error}")
        except KeyboardInterrupt:
            display.say("reconfigure: interrupted; robots under way were told to stop")
    return 1


def _parser():
    parser = argparse.ArgumentParser(
        prog="reconfigure",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("targets", metavar="TARGETS", help="table, problem.npz, or random[:SEED]")
    parser.add_argument("--home-first", action="store_true", help="fold the robots before")
    parser.add_argument("--no-start", action="store_true", help="plan and leave the orders waiting")
    parser.add_argument(
        "--timeout", type=float, default=120.0, metavar="S", help="of each wait [s], default 120"
    )
    parser.add_argument("--json", action="store_true", help="print the result as one line of JSON")
    return parser


def _run(client, options, display) -> int:
    client.wait_for_graph(options.timeout)
    if options.home_first:
        ended = _moved(client, lambda: client.home(options.timeout), options.timeout)
        display.say(f"home: {ended.count(Outcome.REACHED)} of {len(ended.ids)} robots folded")
    ids, xy_mm = _targets(client, options.targets)
    stamp = client.send_targets(ids, xy_mm)
    client.wait_until_ready(stamp, options.timeout)
    if options.no_start:
        display.say(f"plan {stamp}: its orders wait for start")
        return 0

    def run() -> PlanOutcome:
        client.start(options.timeout)
        return client.wait_for_outcome(stamp, options.timeout)

    ended = _moved(client, run, options.timeout).of(ids)
    if options.json:
        made = client.attempts(stamp).index(client.last_attempt(stamp)) + 1
        attempts = {"attempts": made}
        went = _how_it_went(client.times[stamp], display)
        print(json.dumps(_as_json(ended) | attempts | went))
    else:
        print(summary(ended))
    return 0 if went_well(ended) else 1


def _moved(client, move, timeout_s) -> PlanOutcome:
    # whoever interrupts a motion means the robots
    try:
        return move()
    except KeyboardInterrupt:
        client.call_service(topics.STOP, timeout_s)
        raise


def _targets(client, source):
    if source != "random" and not source.startswith("random:"):
        return read_targets(source)
    seed = source.partition(":")[2] or "0"
    if not seed.isdigit():
        raise PlaneError(f"{source}: the seed is no whole number")
    rng = np.random.default_rng(int(seed))
    problem = random_field(client.plane, rng, start=client.angles).problem
    return client.plane.ids[problem.asked], problem.targets[problem.asked]


def went_well(ended: PlanOutcome) -> bool:
    """Return whether the motion ran and each robot reached its target or is held for a reason.

    Args:
        ended: what became of the robots asked.
    """
    failed = ended.outcome == Outcome.FAILED
    return not (failed | np.isin(ended.reason, _NOT_RUN)).any()


def count_outcomes(ended: PlanOutcome) -> list[tuple[str, str, int]]:
    """Return outcome, reason and number of robots, for all that occur."""
    pairs, counts = np.unique(
        np.stack([ended.outcome, ended.reason], axis=1), axis=0, return_counts=True
    )
    return [
        (Outcome(outcome).name.lower(), Reason(reason).name.lower(), int(count))
        for (outcome, reason), count in zip(pairs, counts)
    ]


def summary(ended: PlanOutcome) -> str:
    """Return a table of outcomes and the first robots that did not reach their target."""
    rows = [("outcome", "reason", "robots"), *count_outcomes(ended)]
    rows.append(("asked", "", len(ended.ids)))
    lines = [table(rows)]
    missed = np.flatnonzero(ended.outcome != Outcome.REACHED)
    if len(missed):
        shown = [("robot", "outcome", "reason", "error mm")]
        shown += [
            (
                int(ended.ids[row]),
                Outcome(ended.outcome[row]).name.lower(),
                Reason(ended.reason[row]).name.lower(),
                f"{ended.error_mm[row]:.3f}",
            )
            for row in missed[:_SHOWN]
        ]
        more = len(missed) - _SHOWN
        lines += ["", table(shown)] + ([f"and {more} more"] if more > 0 else [])
    return "\n".join(lines)


def _how_it_went(times, display) -> dict:
    # when each stage was done, from the sending of the targets on
    done_s = {name: round(at - times["sent"], 3) for name, at in times.items() if name != "sent"}
    return {"done_s": done_s, "buses": display.buses.totals, "alerts": display.alerts}


def _as_json(ended: PlanOutcome) -> dict:
    missed = ended.outcome != Outcome.REACHED
    return {
        "plan": str(PlanStamp(ended.stamp_ns)),
        "asked": len(ended.ids),
        **{outcome.name.lower(): ended.count(outcome) for outcome in Outcome},
        "reasons": {reason: count for _, reason, count in count_outcomes(ended)},
        "not_reached": [
            {
                "id": int(robot),
                "outcome": Outcome(outcome).name.lower(),
                "reason": Reason(reason).name.lower(),
                "error_mm": None if np.isnan(error) else float(error),
            }
            for robot, outcome, reason, error in zip(
                ended.ids[missed],
                ended.outcome[missed],
                ended.reason[missed],
                ended.error_mm[missed],
            )
        ],
    }
