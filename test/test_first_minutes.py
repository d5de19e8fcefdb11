# SPDX-License-Identifier: Apache-2.0
"""What a first user meets: refusals at once in one line, and progress of what takes minutes."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def inputs(clone=ROOT, out="out/demo", seed="", robots="", *files):
    command = [ROOT / "tools/check_inputs.sh", clone, out, seed, robots, *files]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_good_inputs_are_let_through(tmp_path):
    (tmp_path / "a.csv").touch()
    ran = inputs(tmp_path, tmp_path / "new/folder", "7", "500", f"{tmp_path}/a.csv,README.md")
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv"]  # nothing is left behind


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"seed": "-1"}, "SEED=-1"),
        ({"seed": "1.5"}, "SEED=1.5"),
        ({"robots": "0"}, "ROBOTS=0"),
        ({"robots": "many"}, "ROBOTS=many"),
        ({"out": "README.md/below"}, "OUT=README.md/below cannot be written"),
        ({"out": "README.md"}, "OUT=README.md cannot be written"),
        ({"out": "/proc/fiber"}, "OUT=/proc/fiber cannot be written"),
        ({"clone": "/proc"}, "/proc cannot be written to"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_would_fail_later_is_refused_in_one_line(given, words):
    ran = inputs(**given)
    assert ran.returncode == 1 and ran.stderr.count("\n") == 1 and words in ran.stderr


def test_a_file_that_is_missing_is_named(tmp_path):
    ran = inputs(ROOT, tmp_path, "", "", "README.md,missing.csv")
    assert ran.returncode == 1 and ran.stderr == "missing.csv: there is no such file\n"


NO_NETWORK = ["unshare", "--map-root-user", "--net"]


@pytest.mark.skipif(
    shutil.which("unshare") is None
    or subprocess.run([*NO_NETWORK, "true"], check=False).returncode,
    reason="NOT TESTED: a machine without loopback: needs unshare",
)
def test_a_machine_without_loopback_is_refused_in_one_line(tmp_path):
    command = [*NO_NETWORK, ROOT / "tools/check_inputs.sh", ROOT, tmp_path, "", ""]
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ran.returncode == 1 and ran.stderr.count("\n") == 1
    assert "the loopback interface is down" in ran.stderr


def _by_hand():
    # the environment of a make that is called by hand, and not by the make that runs the tests
    made = ("MAKEFLAGS", "MAKELEVEL")
    return {name: value for name, value in os.environ.items() if name not in made}


def make(*words):
    # the whole of it is built again if anything is built
    command = ["make", "-W", "requirements.lock", *words]
    return subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, env=_by_hand(), timeout=60
    )


@pytest.mark.skipif(shutil.which("make") is None, reason="NOT TESTED: make is not installed")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["bench", "FAULTS=stall:2"], "FAULTS=stall:2 has no effect"),
        (["bench", "TARGETS=missing.csv"], "missing.csv: there is no such file"),
        (["console", "SEED=-1"], "SEED=-1"),
        (["demo", "OUT=README.md"], "OUT=README.md cannot be written"),
    ],
    ids=lambda value: value[1] if isinstance(value, list) else "",
)
def test_nothing_is_built_before_a_refusal(words, said):
    ran = make(*words)
    assert ran.returncode != 0 and said in ran.stderr and ran.stdout == ""


@pytest.mark.skipif(shutil.which("make") is None, reason="NOT TESTED: make is not installed")
def test_a_clone_in_a_path_with_a_space_is_refused_in_one_line(tmp_path):
    clone = tmp_path / "a clone"
    clone.mkdir()
    shutil.copy(ROOT / "Makefile", clone)
    ran = subprocess.run(
        ["make", "demo"], cwd=clone, capture_output=True, text=True, check=False, env=_by_hand()
    )
    assert ran.returncode != 0 and ran.stderr.count("\n") == 1 and "has a space" in ran.stderr


def test_the_installation_tells_how_far_it_is():
    lines = [f"Collecting package{k}==1.0" for k in range(100)]
    lines += [
        "  Downloading x",
        "Installing collected packages: a, b",
        "Successfully installed a b",
    ]
    ran = subprocess.run(
        [ROOT / "tools/pip_progress.sh", "100"],
        input="\n".join(lines) + "\n",
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stdout.splitlines() == [
        "fetched 40 of 100 packages",
        "fetched 80 of 100 packages",
        "unpacking 100 packages",
        "installed 100 packages",
    ]
