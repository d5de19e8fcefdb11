#!/usr/bin/env python3
"""Take the pictures of docs/images from the output of `make demo`, with a headless Chromium.

The figures come from the same recording. One picture is of a night that went wrong, if there is a
recording of it: `make demo FAULTS=scl_stuck,stall:2 SEED=4 OUT=out/faults`. `make screenshots`
runs this.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from fiber_core.outcomes import Outcome
from fiber_recording import load_recording
from fiber_viewer import figures
from fiber_viewer.page import write_player

# name of the picture: size of the window, then the moment: part of the makespan, and the rest
_SHOTS = {
    "player.png": ((1440, 900), 0.40, "theme=light"),
    "player-dark.png": ((1440, 1990), 0.55, "theme=dark"),
    "player-phone.png": ((500, 980), 0.40, "theme=light"),
}
_FAULTS = ("player-faults.png", (1440, 1010), "theme=light")
_FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --hide-scrollbars "
    "--disable-background-networking --disable-component-update --disable-sync "
    "--virtual-time-budget=4000"
).split()


def main(argv: list[str] | None = None) -> int:
    """Take all pictures; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path, nargs="?", default=Path("out/demo/recording.npz"))
    parser.add_argument("--faults", type=Path, help="recording of a night that went wrong")
    parser.add_argument("-o", "--out", type=Path, default=Path("docs/images"))
    args = parser.parse_args(argv)
    browser = shutil.which("chromium")
    if browser is None:
        print("screenshots: chromium is not installed", file=sys.stderr)
        return 1
    recording = load_recording(args.recording)
    args.out.mkdir(parents=True, exist_ok=True)
    figures.conflict(recording).savefig(args.out / "conflict.png", dpi=80)
    rows = figures.conflict_rows(recording)[:2]
    figures.velocities(recording, rows).savefig(args.out / "velocities.png", dpi=80)
    bent = recording.order_segments[0].max(axis=1).argsort(kind="stable")[-2:]
    figures.positions(recording, bent).savefig(args.out / "positions.png", dpi=80)
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "player.html"
        write_player(page, args.recording)
        for name, (size, part, more) in _SHOTS.items():
            moment = f"#t={part * recording.executed.makespan_s:.3f}&{more}"
            _picture(browser, page, moment, args.out / name, size, folder)
        if args.faults:
            write_player(page, args.faults)
            name, size, more = _FAULTS
            wrong = load_recording(args.faults)
            t = wrong.pauses_s[-1][0] if wrong.pauses_s else wrong.executed.makespan_s
            robot = wrong.problem.plane.ids[(wrong.outcome == Outcome.FAILED).argmax()]
            moment = f"#t={t:.3f}&robots={robot}&{more}"
            _picture(browser, page, moment, args.out / name, size, folder)
    return 0


def _picture(browser, page, moment, path, size, folder):
    _shoot(browser, page.as_uri() + moment, path, size, Path(folder) / "profile")
    picture = Image.open(path).convert("RGB")
    picture.quantize(256, Image.Quantize.MAXCOVERAGE).save(path)
    print(path)


def _shoot(browser, address, picture, size, profile):
    command = [browser, *_FLAGS, f"--user-data-dir={profile}", f"--screenshot={picture}"]
    # the libraries of ROS wheels are not for other programs
    clean = {name: value for name, value in os.environ.items() if not name.startswith("LD_")}
    subprocess.run(
        [*command, "--window-size={},{}".format(*size), address],
        check=True,
        env=clean,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        timeout=120,
    )


if __name__ == "__main__":
    sys.exit(main())
