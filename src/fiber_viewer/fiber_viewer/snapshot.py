"""Command: draw the plane before and after a plan from its exchange files."""

import argparse
from pathlib import Path

from fiber_core.problem import load_plan, load_problem
from fiber_viewer.figures import before_and_after

__all__ = ["main"]


def main(argv: list[str] | None = None) -> int:
    """Run the command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="snapshot", description=__doc__)
    parser.add_argument("problem", type=Path, help="problem.npz")
    parser.add_argument("plan", type=Path, help="plan.npz")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("plane.png"), help="picture, PNG or PDF"
    )
    args = parser.parse_args(argv)
    problem = load_problem(args.problem)
    motion, outcome = load_plan(args.plan, problem.start)
    before_and_after(problem, motion, outcome).savefig(args.out, dpi=150)
    return 0
