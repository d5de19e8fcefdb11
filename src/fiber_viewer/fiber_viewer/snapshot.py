# SPDX-License-Identifier: Apache-2.0
"""Draw the plane before and after a plan, from problem.npz and plan.npz."""

import argparse
from pathlib import Path

from fiber_core.problem import load_plan, load_problem
from fiber_viewer.figures import before_and_after

__all__ = ["main"]


def main(argv: list[str] | None = None) -> int:
    """Run the command; return the exit code.

    Args:
        argv: arguments; by default those of the process.

    Raises:
        FiberError: a file is malformed.
    """
    parser = argparse.ArgumentParser(prog="snapshot", description=__doc__)
    parser.add_argument("problem", type=Path, help="problem to read (.npz)")
    parser.add_argument("plan", type=Path, help="plan to read (.npz)")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("plane.png"), help="picture to write (.png or .pdf)"
    )
    args = parser.parse_args(argv)
    problem = load_problem(args.problem)
    motion, outcome = load_plan(args.plan, problem.start)
    before_and_after(problem, motion, outcome).savefig(args.out, dpi=150)
    return 0
