#!/usr/bin/env python3
"""Take the pictures of docs/images from the output of `make demo`, with a headless Chromium.

The plane's figures come from the same recording. Run by `make screenshots`.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

from fiber_viewer import figures, load_recording
from fiber_viewer.page import write_player

# name of the picture: size of the window, then the moment: part of the makespan, and the rest
_SHOTS = {
    "player.png": ((1440, 900), 0.40, "theme=light"),
    "player-dark.png": ((1440, 1990), 0.55, "theme=dark"),
    "player-phone.png": ((500, 980), 0.40, "theme=light"),
}
_FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --hide-scrollbars "
    "--disable-background-networking --disable-component-update --disable-sync "
    "--virtual-time-budget=4000"
).split()


def main(argv: list[str] | None = None) -> int:
    """Take all pictures; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path, nargs="?", default=Path("out/demo/recording.npz"))
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
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "player.html"
        write_player(page, args.recording)
        for name, (size, part, more) in _SHOTS.items():
            moment = f"#t={part * recording.decoded.makespan_s:.3f}&{more}"
            _shoot(browser, page.as_uri() + moment, args.out / name, size, Path(folder) / "profile")
            Image.open(args.out / name).convert("RGB").quantize(
                256, Image.Quantize.MAXCOVERAGE
            ).save(args.out / name)
            print(args.out / name)
    return 0


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
