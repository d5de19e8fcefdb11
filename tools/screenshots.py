#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Take the pictures of docs/images from the recording of `make demo`, with headless Chromium.

The figures are drawn from the same recording. Other recordings give one more picture each:

- of a plan with faults: `make demo FAULTS=scl_stuck,stall:2 SEED=4 OUT=out/faults`;
- of one that a camera saw: `make demo TOLERANCE_UM=15 PRESET=desi_petals SEED=3 OUT=out/camera`;
- of one with a cap on the motors: `fiber-positioners plan --preset desi_petals --drive desi
  --motors-on 0.55 --seed 1 --out out/motors`.

`make screenshots` runs this script with all that it finds.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from headless_chromium import FLAGS, clean_environment
from PIL import Image

from fiber_core.outcomes import Outcome
from fiber_recording import load_recording
from fiber_viewer import figures
from fiber_viewer.page import write_player

# name of the picture -> size of the window, time as a part of the makespan, rest of the address
_SHOTS = {
    "player.png": ((1440, 900), 0.40, "theme=light"),
    "player-dark.png": ((1440, 1990), 0.55, "theme=dark"),
    "player-phone.png": ((500, 980), 0.40, "theme=light"),
}
_FAULTS_SHOT = ("player-faults.png", (1440, 1010), "theme=light")
# one panel alone: name of the picture, size of the window, rest of the address
_IMAGES_SHOT = ("player-images.png", (1440, 900), "panel=8&theme=light")
_MOTORS_SHOT = ("player-motors.png", (1440, 620), "panel=7&theme=light")
_TIME = "--virtual-time-budget=4000"  # of the page [ms]


def main(argv: list[str] | None = None) -> int:
    """Take all pictures; return the exit code.

    Args:
        argv: arguments; by default those of the process.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "recording",
        type=Path,
        nargs="?",
        default=Path("out/demo/recording.npz"),
        help="recording of a plan without faults",
    )
    parser.add_argument("--faults", type=Path, help="recording of a plan with faults")
    parser.add_argument("--camera", type=Path, help="recording of a plan that a camera saw")
    parser.add_argument("--motors", type=Path, help="recording of a plan with a cap on the motors")
    parser.add_argument("-o", "--out", type=Path, default=Path("docs/images"), help="folder")
    args = parser.parse_args(argv)
    browser = shutil.which("chromium")
    if browser is None:
        print("screenshots: chromium is not installed: install it", file=sys.stderr)
        return 1
    recording = load_recording(args.recording)
    args.out.mkdir(parents=True, exist_ok=True)
    figures.conflict(recording).savefig(args.out / "conflict.png", dpi=80)
    rows = figures.conflict_rows(recording)[:2]
    figures.velocities(recording, rows).savefig(args.out / "velocities.png", dpi=80)
    most_segments = recording.order_segments[0].max(axis=1).argsort(kind="stable")[-2:]
    figures.positions(recording, most_segments).savefig(args.out / "positions.png", dpi=80)
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "player.html"
        write_player(page, args.recording)
        for name, (size, part, more) in _SHOTS.items():
            view = f"#t={part * recording.executed.makespan_s:.3f}&{more}"
            _take_picture(browser, page, view, args.out / name, size, Path(folder))
        if args.faults:
            write_player(page, args.faults)
            name, size, more = _FAULTS_SHOT
            faults = load_recording(args.faults)
            # half way through the last pause, when all robots rest
            pause_s = faults.pauses_s[-1] if faults.pauses_s else [faults.executed.makespan_s]
            t = sum(pause_s) / len(pause_s)
            robot = faults.problem.plane.ids[(faults.outcome == Outcome.FAILED).argmax()]
            view = f"#t={t:.3f}&robots={robot}&{more}"
            _take_picture(browser, page, view, args.out / name, size, Path(folder))
        for given, (name, size, more) in ((args.camera, _IMAGES_SHOT), (args.motors, _MOTORS_SHOT)):
            if given:
                write_player(page, given)
                t = 0.3 * load_recording(given).executed.makespan_s
                view = f"#t={t:.3f}&{more}"
                _take_picture(browser, page, view, args.out / name, size, Path(folder))
    return 0


def _take_picture(
    browser: str, page: Path, view: str, path: Path, size: tuple[int, int], folder: Path
) -> None:
    """Take a picture of a page, with at most 256 colours.

    Args:
        browser: path of Chromium.
        page: the page.
        view: what it shows: the part of its address from # on.
        path: the picture to write.
        size: width and height of the window [pixels].
        folder: a folder for the profile of the browser.
    """
    _run_browser(browser, page.as_uri() + view, path, size, folder / "profile")
    picture = Image.open(path).convert("RGB")
    picture.quantize(256, Image.Quantize.MAXCOVERAGE).save(path)
    print(path)


def _run_browser(
    browser: str, address: str, picture: Path, size: tuple[int, int], profile: Path
) -> None:
    command = [browser, *FLAGS, _TIME, f"--user-data-dir={profile}", f"--screenshot={picture}"]
    subprocess.run(
        [*command, "--window-size={},{}".format(*size), address],
        check=True,
        env=clean_environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        timeout=120,
    )


if __name__ == "__main__":
    sys.exit(main())
