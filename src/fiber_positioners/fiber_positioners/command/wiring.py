# SPDX-License-Identifier: Apache-2.0
"""The subcommand `wiring`: code words out, lights of the images in, swapped robots out."""

import argparse
import json

import numpy as np

from fiber_core.errors import FiberError
from fiber_core.presets import PRESETS
from fiber_formats import kind_of, read_layout, read_starts, write_table
from fiber_metrology import WiringConfig, code_words, tell_wiring
from fiber_positioners.command.arguments import positive
from fiber_positioners.command.exit_codes import DONE
from fiber_positioners.wiring_tables import read_lights, write_turns

__all__ = ["DESCRIPTION", "SUMMARY", "add_arguments", "run"]

SUMMARY = "tell which order moves which fibre: swapped and lost robots, by code words"
DESCRIPTION = """Tell which fibre the orders for each robot move, from images of code words.

Without --lights TABLE becomes the turns: image, id, and phi_turn_deg from where the robot rested
before the first image. They move no point of an arm by more than half of --margin-mm: nothing can
touch where robots stopped under a certificate with that margin, have made no test turns since, and
turn phi by their orders of phi. With --starts no turn leads out of the range of phi. With --lights,
a table of what each image shows (image, x_mm, y_mm), and the same other options, TABLE becomes the
answer: a verdict for each robot, the robot at whose place its orders move a fibre, and the doubt.

examples:
  fiber-positioners wiring --layout plane.csv turns.csv
  fiber-positioners wiring --layout plane.csv --lights lights.csv wiring.csv
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("target", metavar="TABLE", help="the table to write: .csv, .ecsv or .fits, also with .gz")
    add("--layout", metavar="FILES", required=True, help="the plane: a file, or several")
    add("--preset", choices=sorted(PRESETS), help="supplies what the layout lacks")
    add("--starts", metavar="FILES", help="present angles; by default no turn is shortened")
    add("--lights", metavar="TABLE", help="table of the lights of each image")
    add("--images", type=positive, default=32, help="number of images, 16 or 32")
    add("--margin-mm", type=float, default=0.05, help="gap that robots keep at rest [mm]")
    add("--error-um", type=float, default=4.5, help="error of a coordinate of a light [um]")
    add("--seed", type=int, default=0, help="of the code words")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand; returns the exit code."""
    kind_of(args.target)
    if not 0.0 < args.margin_mm <= 1.0:
        raise FiberError(f"--margin-mm {args.margin_mm} is not above 0 and at most 1")
    plane = read_layout(args.layout, args.preset).plane
    phi = None if args.starts is None else read_starts(args.starts, plane).angles[:, 1]
    rng = np.random.default_rng(args.seed)
    words = code_words(plane, rng, args.images, args.margin_mm, phi_rad=phi)
    if args.lights is None:
        write_turns(args.target, plane, words)
        print(f"turns of {plane.n} robots before {words.images} images are in {args.target}")
        return DONE
    images = read_lights(args.lights, words.images)
    found = tell_wiring(plane, words, images, WiringConfig(error_um=args.error_um))
    write_table(args.target, found.columns(plane))
    print("\n".join([*found.lines(plane), json.dumps(found.counts())]))
    return DONE
