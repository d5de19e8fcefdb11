"""Run a small plane through the installed cores, so that every loop is compiled and cached."""

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "bench"))

import numpy as np
from plan_field import carry_out

from fiber_core.fields import random_problem
from fiber_core.presets import preset
from fiber_planner import make_planner, planners


def _small():
    return random_problem(preset("desi_outlines", robots=37), np.random.default_rng(0))


def _plan(name: str) -> None:
    make_planner(name).plan(_small())


def main() -> int:
    """Compile on two cores, then once through the whole chain; returns the exit code."""
    with ProcessPoolExecutor(2) as pool:
        done = [pool.submit(carry_out, _small(), "dnf")]
        done += [pool.submit(_plan, name) for name in planners() if name != "dnf"]
        for each in done:
            each.result()
    return 0


if __name__ == "__main__":
    sys.exit(main())
