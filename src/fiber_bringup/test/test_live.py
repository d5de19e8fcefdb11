# SPDX-License-Identifier: Apache-2.0
"""The processes of a live plane are watched: a console may end, but not again and again."""

import pytest

from fiber_bringup.errors import ProcessError
from fiber_bringup.live import _parser, _start_camera, _watch
from fiber_core.errors import FiberError


class Processes:
    """Processes of which the console ends every `lasts_s`; it models nothing else."""

    def __init__(self, lasts_s, also=()):
        self.now_s, self.lasts_s, self.also = 0.0, lasts_s, list(also)
        self.restarted_s = [0.0]

    def ended(self):
        over = self.now_s >= self.restarted_s[-1] + self.lasts_s
        return ["console"] * over + self.also

    def restart(self, name):
        assert name == "console"
        self.restarted_s.append(self.now_s)

    def check(self):
        raise ProcessError(f"{self.ended()} have ended")

    def pause(self, seconds):
        self.now_s += seconds
        if self.now_s > 1000.0:
            raise KeyboardInterrupt

    def watch(self):
        _watch(self, lambda: self.now_s, self.pause)


def test_a_console_that_ends_at_once_is_not_restarted_for_ever():
    processes = Processes(lasts_s=1.0)
    with pytest.raises(ProcessError, match="console"):
        processes.watch()
    assert len(processes.restarted_s) == 4 and processes.now_s < 10.0


def test_a_console_that_ends_now_and_then_is_restarted_each_time():
    processes = Processes(lasts_s=100.0)
    with pytest.raises(KeyboardInterrupt):
        processes.watch()
    assert len(processes.restarted_s) > 8


def test_the_end_of_another_process_is_an_error():
    processes = Processes(lasts_s=1e9, also=["bridge"])
    with pytest.raises(ProcessError, match="bridge"):
        processes.watch()


class Started:
    """What was started, by name."""

    def __init__(self):
        self.parameters = {}

    def start(self, package, name, parameters):
        self.parameters[name] = parameters


def test_a_camera_is_started_where_it_is_asked_for_and_sees_swapped_plugs():
    started = Started()
    _start_camera(started, "plant.sock", _parser().parse_args([]))
    assert not started.parameters
    options = _parser().parse_args(["--camera", "--swapped", "3-17", "--seed", "4"])
    _start_camera(started, "plant.sock", options)
    camera = started.parameters["camera"]
    assert set(started.parameters) == {"metrology", "camera"}
    assert (camera["plant"], camera["swapped"], camera["seed"]) == ("plant.sock", "3-17", 4)
    with pytest.raises(FiberError, match="--camera is missing"):
        _start_camera(started, "plant.sock", _parser().parse_args(["--swapped", "3-17"]))
