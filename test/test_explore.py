# SPDX-License-Identifier: Apache-2.0
"""The command bench/explore.py: it prints what it has visited, and fails when a rule is broken."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from fiber_bus_bridge.protocol import starting


@pytest.fixture
def command(monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "bench")
    return importlib.import_module("explore")


def test_the_command_counts_states_and_says_whether_it_saw_all(command, capsys):
    assert command.main(["--faults", "0"]) == 0
    row = capsys.readouterr().out.splitlines()[2].split("|")
    assert row[1:3] == [" 2 x 1 ", " 0 "] and int(row[3]) > 10 and " yes " in row
    assert command.main(["--steps", "50"]) == 0
    assert "| no |" in capsys.readouterr().out


def test_the_command_fails_and_names_the_faults_that_led_to_a_broken_rule(
    command, capsys, monkeypatch
):
    def asked(c, rows, t):
        return c.transactions.statuses(rows, t)

    monkeypatch.setattr(starting, "stop_all", asked)
    assert command.main(["--unprotected"]) == 1
    story = capsys.readouterr().out.splitlines()[-1]
    assert "; robot" in story and " moves " in story
    assert np.any([f"{state}: " in story for state in ("COUNTDOWN", "CERTIFIED")])
