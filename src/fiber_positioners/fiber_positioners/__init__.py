# SPDX-License-Identifier: Apache-2.0
"""Plan and carry out reconfigurations of a focal plane of fibre positioners, without ROS.

from fiber_positioners import preset, random_problem, reconfigure

result = reconfigure(random_problem(preset("desi", robots=500), seed=1))
print(result.report)
"""

from fiber_core.clearance import Safety
from fiber_core.custom_plane import hexagonal
from fiber_core.errors import FiberError
from fiber_core.focal_plane import FocalPlane
from fiber_core.outcomes import Outcome, Reason
from fiber_core.presets import PRESETS, preset
from fiber_core.problem import Problem, load_problem, save_problem
from fiber_formats import read_starts, read_targets, write_results
from fiber_planner import PlannedMotion, Planner, planners
from fiber_positioners.closed_loop import ClosedLoop, LoopConfig, closed_loop
from fiber_positioners.orders import Orders, make_orders
from fiber_positioners.problems import random_problem, read_layout, with_targets
from fiber_positioners.reconfiguration import Reconfiguration, reconfigure
from fiber_positioners.simulated_run import SimulatedRun, run_on_simulated_buses
from fiber_recording import Recording, load_recording

__all__ = [
    "ClosedLoop",
    "LoopConfig",
    "closed_loop",
    "PRESETS",
    "FiberError",
    "FocalPlane",
    "Orders",
    "Outcome",
    "PlannedMotion",
    "Planner",
    "Problem",
    "Reason",
    "Reconfiguration",
    "Recording",
    "Safety",
    "SimulatedRun",
    "hexagonal",
    "load_problem",
    "load_recording",
    "make_orders",
    "planners",
    "preset",
    "random_problem",
    "read_layout",
    "read_starts",
    "read_targets",
    "reconfigure",
    "run_on_simulated_buses",
    "save_problem",
    "with_targets",
    "write_results",
]
