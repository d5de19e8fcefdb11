# SPDX-License-Identifier: Apache-2.0
"""Take a running focal plane to new targets: plan, start, wait for the outcome, print it.

TARGETS are files of any format that fiber_formats reads, as a table with columns id, x_mm, y_mm, a
problem.npz, or random[:SEED] for targets that all enabled robots can take at once, drawn for the
plane that is running. Progress, rates and alerts go to stderr, the result to stdout: a table, or
with --json one line with the outcomes, the time at which each stage was done, the traffic on the
buses, and all alerts. --results writes all robots of the plane to a table.
With --tolerance-um a camera decides: image, correction, image; outcome and error of each robot come
from the last image.
Exit code 0: the motion ran, and each robot with a target reached it or is held with a reason;
anything else is 1.
"""

import argparse
import json
import signal
import sys
from collections.abc import Sequence

import numpy as np
from rclpy.utilities import remove_ros_args

from fiber_client.client import PlaneClient
from fiber_client.closed_loop import CameraLoop, show_images
from fiber_client.errors import PlaneError
from fiber_client.terminal import ProgressDisplay, table
from fiber_core.array_types import Ids, Ints, Points
from fiber_core.errors import FiberError
from fiber_core.fibres import ANY_FIBRE
from fiber_core.fields import random_field
from fiber_core.outcomes import Outcome, PlanOutcome, Reason
from fiber_formats import FORMS, check_results, read_targets, write_results
from fiber_msgs_py import PlanStamp
from fiber_node.ros_environment import use_loopback

__all__ = ["count_outcomes", "main", "summary", "went_well"]

_ITERATIONS = 1  # corrections
_SHOWN = 5  # robots not reached that are named
_NOT_RUN = (Reason.STOPPED, Reason.NOT_PLANNED)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one reconfiguration from the command line; return the exit code."""
    args = sys.argv if argv is None else ["reconfigure", *argv]
    options = _parser().parse_args(remove_ros_args(args)[1:])
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C
    use_loopback()
    with ProgressDisplay() as display:
        try:
            with PlaneClient(on_progress=display, on_status=display.status, args=args) as client:
                return _run(client, options, display)
        except FiberError as error:
            display.say(f"reconfigure: {error}")
        except KeyboardInterrupt:
            display.say("reconfigure: interrupted")  # a stop that was ordered is in the log
    return 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="reconfigure",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("targets", metavar="TARGETS", help="table, problem.npz, or random[:SEED]")
    parser.add_argument("--home-first", action="store_true", help="fold all robots before")
    parser.add_argument(
        "--no-start", action="store_true", help="plan only; the service start starts the plan"
    )
    parser.add_argument(
        "--timeout", type=float, default=120.0, metavar="S", help="time-out of each wait [s], 120"
    )
    parser.add_argument(
        "--tolerance-um", type=float, metavar="T",
        help="take images and correct, until fibres are so close to their targets [um]",
    )  # fmt: skip
    parser.add_argument(
        "--iterations", type=int, metavar="N",
        help=f"largest number of corrections, {_ITERATIONS}; needs --tolerance-um",
    )  # fmt: skip
    parser.add_argument(
        "--results",
        metavar="TABLE",
        help="write all robots: .csv, .ecsv, .fits, or .par in the form sdss_v, also with .gz",
    )
    parser.add_argument(
        "--form", choices=sorted(FORMS), help="columns of an instrument in addition, in --results"
    )
    parser.add_argument("--json", action="store_true", help="print the result as one line of JSON")
    return parser


def _run(client: PlaneClient, options: argparse.Namespace, display: ProgressDisplay) -> int:
    if options.results is not None:
        check_results(options.results, options.form)  # refused before the motion, not after it
    elif options.form is not None:
        raise PlaneError("--form tells columns of --results, which is not given")
    loop = _camera_loop(client, options)
    # the metrology has to hear where the robots are before they move
    client.wait_for_graph(options.timeout, () if loop is None else ("metrology",))
    if loop is not None and client.plane.fibres.shape[1]:
        names = ", ".join(client.plane.fibre_names)
        raise PlaneError(f"the camera sees one fibre at each tip, the plane has {names}")
    if options.home_first:
        with client.stops_on_error(options.timeout):
            folded = client.home(options.timeout)
        reached = folded.count(Outcome.REACHED)
        display.say(f"home: {reached} of {len(folded.ids)} robots folded")
    ids, xy_mm, fibre = _targets(client, options.targets, display)
    with client.stops_on_error(options.timeout):  # stop ends planning too
        stamp = client.send_targets(ids, xy_mm, fibre)
        client.wait_until_ready(stamp, options.timeout)
    if options.no_start:
        display.say(f"plan {stamp}: its orders are ready; call the service start to start them")
        return 0
    with client.stops_on_error(options.timeout):
        client.start(options.timeout)
        ended = client.wait_for_outcome(stamp, options.timeout)
    seen: dict[str, object] = {}
    if loop is not None:
        closed = loop.run(ids, xy_mm, ended)
        ended, seen = closed.outcome, show_images(closed, display.say)
    outcome = ended.of(ids)
    if options.results is not None:
        _write_results(client, options, ended, (ids, xy_mm, fibre))
    if options.json:
        made = client.attempts(stamp).index(client.last_attempt(stamp)) + 1
        statistics = _statistics(client.times[stamp], display)
        print(json.dumps(_as_json(outcome) | {"attempts": made} | statistics | seen))
    else:
        print(summary(outcome))
    return 0 if went_well(outcome) and not seen.get("ended") else 1


def _camera_loop(client: PlaneClient, options: argparse.Namespace) -> CameraLoop | None:
    if options.tolerance_um is None:
        if options.iterations is not None:
            raise PlaneError("--iterations tells how often to correct, and needs --tolerance-um")
        return None
    if options.no_start:
        raise PlaneError("--tolerance-um corrects after a motion, and --no-start starts none")
    iterations = _ITERATIONS if options.iterations is None else options.iterations
    return CameraLoop(client, options.tolerance_um, iterations, options.timeout)


def _write_results(
    client: PlaneClient,
    options: argparse.Namespace,
    ended: PlanOutcome,
    asked: tuple[Ids, Points, Ints],
) -> None:
    # a row for each robot, its angles as the encoders read them after the motion
    ids, xy_mm, fibre = asked
    plane = client.plane
    rows = plane.index_of(ids)
    targets, chosen = np.full((plane.n, 2), np.nan), np.full(plane.n, ANY_FIBRE)
    targets[rows[rows >= 0]], chosen[rows[rows >= 0]] = xy_mm[rows >= 0], fibre[rows >= 0]
    plane = plane.with_fibre(chosen)
    write_results(options.results, plane, ended, client.angles, options.form, targets)


def _targets(
    client: PlaneClient, source: str, display: ProgressDisplay
) -> tuple[Ids, Points, Ints]:
    # ids, targets and the fibres that they are for
    if source != "random" and not source.startswith("random:"):
        found = read_targets(source, client.plane)
        for line in (found.summary, *found.notices):
            display.say(line)
        return found.ids, found.xy_mm, found.fibre_numbers(client.plane)
    seed = source.partition(":")[2] or "0"
    if not seed.isdigit():
        raise PlaneError(f"{source}: the seed {seed!r} is not a whole number")
    rng = np.random.default_rng(int(seed))
    problem = random_field(client.plane, rng, start=client.angles).problem
    asked = problem.asked
    return client.plane.ids[asked], problem.targets[asked], problem.plane.fibre[asked]


def went_well(outcome: PlanOutcome) -> bool:
    """Return whether the motion ran and each robot reached its target or is held with a reason.

    Args:
        outcome: the outcome of the robots with targets.
    """
    failed = outcome.outcome == Outcome.FAILED
    return not (failed | np.isin(outcome.reason, _NOT_RUN)).any()


def count_outcomes(outcome: PlanOutcome) -> list[tuple[str, str, int]]:
    """Return outcome, reason and number of robots, for all that occur."""
    pairs, counts = np.unique(
        np.stack([outcome.outcome, outcome.reason], axis=1), axis=0, return_counts=True
    )
    return [
        (Outcome(code).name.lower(), Reason(reason).name.lower(), int(count))
        for (code, reason), count in zip(pairs, counts)
    ]


def summary(outcome: PlanOutcome) -> str:
    """Return a table of outcomes, and of the first robots that did not reach their targets."""
    rows: list[tuple[object, ...]] = [("outcome", "reason", "robots"), *count_outcomes(outcome)]
    rows.append(("asked", "", len(outcome.ids)))
    lines = [table(rows)]
    missed = np.flatnonzero(outcome.outcome != Outcome.REACHED)
    if len(missed):
        shown: list[tuple[object, ...]] = [("robot", "outcome", "reason", "error mm")]
        shown += [
            (
                int(outcome.ids[row]),
                Outcome(outcome.outcome[row]).name.lower(),
                Reason(outcome.reason[row]).name.lower(),
                f"{outcome.error_mm[row]:.3f}",
            )
            for row in missed[:_SHOWN]
        ]
        more = len(missed) - _SHOWN
        lines += ["", table(shown)] + ([f"and {more} more"] if more > 0 else [])
    return "\n".join(lines)


def _statistics(times: dict[str, float], display: ProgressDisplay) -> dict[str, object]:
    # when each stage was done, counted from the time at which the targets were sent
    done_s = {name: round(at - times["sent"], 3) for name, at in times.items() if name != "sent"}
    return {"done_s": done_s, "buses": display.buses.totals, "alerts": display.alerts}


def _as_json(outcome: PlanOutcome) -> dict[str, object]:
    missed = outcome.outcome != Outcome.REACHED
    return {
        "plan": str(PlanStamp(outcome.stamp_ns)),
        "asked": len(outcome.ids),
        **{code.name.lower(): outcome.count(code) for code in Outcome},
        "reasons": {reason: count for _, reason, count in count_outcomes(outcome)},
        "not_reached": [
            {
                "id": int(robot),
                "outcome": Outcome(code).name.lower(),
                "reason": Reason(reason).name.lower(),
                "error_mm": None if np.isnan(error) else float(error),
            }
            for robot, code, reason, error in zip(
                outcome.ids[missed],
                outcome.outcome[missed],
                outcome.reason[missed],
                outcome.error_mm[missed],
            )
        ],
    }
