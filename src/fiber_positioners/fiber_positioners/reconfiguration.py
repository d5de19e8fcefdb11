# SPDX-License-Identifier: Apache-2.0
"""One reconfiguration from the problem to the outcome of every robot."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

from fiber_bus_bridge import SessionConfig
from fiber_bus_bridge.frame_log import frame_log
from fiber_core.array_types import Angles, Codes, Floats
from fiber_core.clearance import Certificate, Safety
from fiber_core.focal_plane import FocalPlane
from fiber_core.frame_log import FrameLog
from fiber_core.metrics import ORDER_BYTES_BOUND, plan_metrics
from fiber_core.motion import SegmentMotion
from fiber_core.outcomes import PlanOutcome
from fiber_core.problem import Problem, save_plan, save_problem
from fiber_discretizer import DiscretizeOptions, joint_corridors
from fiber_formats import write_results
from fiber_planner import Planner, pair_bound
from fiber_positioners.held_by_drive import held_by_drive
from fiber_positioners.orders import Orders, ProgressCallback, make_orders, part_of
from fiber_positioners.report import save_report
from fiber_positioners.simulated_run import SimulatedRun, run_on_simulated_buses
from fiber_recording import Recording, build_recording, save_recording
from fiber_viewer import write_player

__all__ = ["Reconfiguration", "reconfigure"]


@dataclass(frozen=True, eq=False)
class Reconfiguration:
    """A reconfiguration that was planned, sent to simulated robots and carried out.

    Args:
        orders: the orders, with the results of planner and discretizer.
        run: the course of the plan on the buses.
        seed: seed of the errors of the robots' clocks.
    """

    orders: Orders
    run: SimulatedRun
    seed: int

    @property
    def problem(self) -> Problem:
        """The problem as it was given."""
        return self.orders.problem

    @property
    def plane(self) -> FocalPlane:
        """The focal plane."""
        return self.orders.plane

    @property
    def motion(self) -> SegmentMotion:
        """The motion decoded from the bytes that the robots verified."""
        return self.run.motion

    @property
    def certificate(self) -> Certificate:
        """Certificate of the motion: margin, joint limits and speeds at every instant."""
        return self.run.certificate

    @property
    def outcome(self) -> Codes:
        """Outcome of each robot: reached, held or failed, shape (n,)."""
        return self.run.result.outcome

    @property
    def reason(self) -> Codes:
        """Reason of each outcome, shape (n,)."""
        return self.run.result.reason

    @property
    def error_mm(self) -> Floats:
        """Distance from tip to target by the encoders [mm], shape (n,), nan without a target."""
        return self.run.result.error_mm

    @cached_property
    def frames(self) -> FrameLog:
        """The frames that went over the buses, from the first LOAD on."""
        return frame_log(self.run.exchanges)

    @cached_property
    def report(self) -> dict[str, object]:
        """Counts, makespan, clearance, segments, bytes and seconds, ready for JSON."""
        costs, orders = self.run.costs, self.orders
        bound = pair_bound(orders.start_problem, orders.safety.margin_mm)
        figures = plan_metrics(
            self.problem,
            self.motion,
            self.certificate,
            self.outcome,
            self.reason,
            orders.safety.margin_mm,
        )
        return {
            "planner": self.orders.planner,
            "seed": self.seed,
            **figures,
            "held_by_drive": held_by_drive(self.orders),
            "reachable_at_once": bound.robots,
            "pair_bound_s": bound.time_s,
            "pair_bound_proven": bound.proven,
            # the bound is of motions in which as many robots arrive as can
            "makespan_to_pair_bound": (
                figures["makespan_s"] / bound.time_s
                if bound.time_s and figures["reached"] >= bound.robots
                else None
            ),
            "bytes_mean": costs["bytes_mean"],
            "bytes_bound": ORDER_BYTES_BOUND,
            "bus_time_s": costs["bus_time_s"],
            "countdown_s": costs["countdown_s"],
            **self.orders.seconds,
            **{name: costs[name] for name in ("upload_s", "certify_s", "encode_s")},
        }

    @property
    def ended(self) -> PlanOutcome:
        """Outcome, reason and error of every robot in one value."""
        result = self.run.result
        return PlanOutcome(0, self.plane.ids, result.outcome, result.reason, result.error_mm)

    @property
    def end_angles(self) -> Angles:
        """Joint angles after the plan by the encoders [rad], shape (n, 2)."""
        return self.orders.units.to_angles(self.run.counts)

    @cached_property
    def recording(self) -> Recording:
        """The recording: everything of the plan in one value, for the player and the figures."""
        orders, plane = self.orders, self.plane
        asked = self.problem.asked
        corridors = joint_corridors(plane, orders.wire.decoded(), orders.safety)
        return build_recording(
            plane,
            orders.units,
            logs=[self.frames],
            outcome=self.ended,
            counts_before=orders.counts,
            counts_after=self.run.counts,
            targets=(plane.ids[asked], self.problem.targets[asked]),
            planned=(plane.ids, orders.planned.motion),
            corridors=(plane.ids, corridors),
            safety=orders.safety,
            about={"seed": self.seed, "planner": orders.planner, "attempts": 1},
        )

    def save(self, folder: str | Path, recording: bool = True) -> Path:
        """Write problem.npz, plan.npz, report.json and recording.npz; return the folder.

        Args:
            folder: the folder, which is made.
            recording: whether to write recording.npz, which takes about as long as the plan.

        Raises:
            OSError: a file cannot be written.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        save_problem(folder / "problem.npz", self.problem)
        drive = self.plane.drive
        save_plan(folder / "plan.npz", self.motion, self.outcome, self.reason, drive)
        save_report(folder / "report.json", self.report)
        if recording:
            save_recording(folder / "recording.npz", self.recording)
        return folder

    def write_results(self, path: str | Path, form: str | None = None) -> None:
        """Write a table of all robots: outcome, reason, reached place, error, angles.

        Args:
            path: the table; .csv, .ecsv, .fits, or .par in the form `sdss_v`, also with .gz.
            form: instrument that gets columns in its own form as well, one of
                `fiber_formats.FORMS`.

        Raises:
            FormatError: the suffix or the form is unknown, or the file cannot be written.
        """
        write_results(path, self.plane, self.ended, self.end_angles, form, self.problem.targets)

    def player(self, page: str | Path) -> Path:
        """Write the player, one HTML page that shows the motion in a browser; return its path.

        Args:
            page: the .html file; its folder is made.

        Raises:
            OSError: the file cannot be written.
        """
        page = Path(page)
        page.parent.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory() as folder:
            path = Path(folder) / "recording.npz"
            save_recording(path, self.recording)
            write_player(page, path)
        return page


def reconfigure(
    problem: Problem,
    *,
    planner: str | Planner | None = None,
    seed: int = 0,
    safety: Safety | None = None,
    options: DiscretizeOptions | None = None,
    capture: str | Path | None = None,
    progress: ProgressCallback | None = None,
    tolerance_mm: float = SessionConfig.tolerance_mm,
) -> Reconfiguration:
    """Plan a reconfiguration, send it to simulated robots, and carry it out.

    Targets are assigned, the planner and the discretizer make certified orders, the orders
    are loaded over simulated buses, verified and certified once more, and the robots move in
    simulated time. A target that cannot be reached is no error: its robot is held and has a
    reason.

    Args:
        problem: the plane, the present joint angles and the targets.
        planner: name of a planner, or an object with the method `plan` of the planner
            interface; by default "direct", or "scheduled" for motors with listed speeds.
        seed: seed of the errors of the simulated robots' clocks.
        safety: margin and timing errors; by default as `Safety` says.
        options: options of the discretizer; by default as `DiscretizeOptions` says.
        capture: folder for waveforms (VCD) and packets (pcap) of the buses.
        progress: called with the fraction of the work that is done, 0..1, and a short text.
        tolerance_mm: distance from its target within which a fibre has reached it [mm]; less than
            what a correction is to mend.

    Raises:
        FiberError: the planner is unknown, or the problem does not suit it; the tolerance is no
            length.
        OSError: the capture cannot be written.
    """
    orders = make_orders(
        problem,
        planner=planner,
        safety=safety,
        options=options,
        progress=part_of(progress, 0.0, 0.8, "orders"),
    )
    moving = part_of(progress, 0.8, 1.0, "buses")
    run = run_on_simulated_buses(
        orders, seed=seed, capture=capture, progress=moving, tolerance_mm=tolerance_mm
    )
    if progress is not None:
        progress(1.0, "the plan is over")
    return Reconfiguration(orders, run, seed)
