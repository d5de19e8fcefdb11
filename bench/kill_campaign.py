# SPDX-License-Identifier: Apache-2.0
"""A small plane whose processes are killed, paused and disturbed, and the judge of its runs."""

import os
import shutil
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from forked_processes import ForkedProcesses
from kill_judge import count_false
from kill_others import OTHERS, SERVICES, Others

from fiber_bus_bridge.plant import PlantTruth, Truth, plant_socket, touching
from fiber_client.client import PlaneClient
from fiber_core.errors import FiberError
from fiber_core.fields import random_field
from fiber_core.outcomes import Outcome, PlanOutcome
from fiber_msgs_py import PlanStamp, Progress, topics
from fiber_node import WaitError

__all__ = ["GIVE_UP_S", "Campaign"]

PROCESSES = ("plant", "bridge", "planner", "discretizer", "recorder", "viewer", "client")
STAGES = ("planning", "discretizing", "loading", "countdown", "moving", "after")
_Line: TypeAlias = dict[str, Any]

_SCALE, _PATIENCE_S = 2.0, 0.3
_COMPILE_S, _WAIT_S = 600.0, 10.0
_END_S = 6.0  # for which a plan should go on at most when all processes are back
_NEVER_S = 40.0  # after which a plan without outcome has no end
_CLIENT, _SENT_KEPT = "reconfigure", 400
_DUMPED_S = 1.0  # by which each process has written its stacks
_NEXT_S, GIVE_UP_S = 5.0, 40.0  # goal for the next reconfiguration, and the longest try


class _Over(FiberError):
    """All processes are back for long, and the plan has not ended."""


class Campaign:
    """A graph of processes, the client that uses it, and the judge of its runs.

    Args:
        folder: folder for logs, recordings and the socket.
        robots: number of robots.
        seed: seed of starts, targets and moments.
        only: processes of the runs, or strangers, or services; empty for all.
    """

    def __init__(self, folder: Path, robots: int, seed: int, only: Sequence[str] = ()):
        self._folder, self._robots, self._seed, self._only = folder, robots, seed, only
        self._socket = plant_socket(f"kill.{os.getpid()}")
        self._processes = ForkedProcesses(folder)
        self._at: dict[str, Callable[[], None]] = {}  # what begins with a stage
        self._lasts_s = dict.fromkeys(STAGES, 0.1) | {"after": 0.5}
        self._back_s = np.inf
        self._newest = PlanStamp(0)  # of the plans that stages tell of

    def __enter__(self) -> "Campaign":
        self._start_processes()
        try:
            self._client.wait_for_graph(_COMPILE_S, also=("recorder",))
            for _ in range(2):  # the first compiles; the second shows how long each stage lasts
                self._measure()
        except BaseException:
            self.__exit__()
            raise
        return self

    def _start_processes(self) -> None:
        plane = {"preset": "desi", "robots": self._robots, "seed": self._seed}
        plant = [f"--{name}={value}" for name, value in plane.items()]
        plant += [f"--socket={self._socket}", f"--memory={self._folder / 'robots'}"]
        plant += [f"--time-scale={_SCALE}", f"--patience={_PATIENCE_S}", "--kept=2000"]
        start = self._processes.start
        self._processes.start_command("fiber_bus_bridge", "plant", plant)
        bridge = {"plant": str(self._socket), "time_scale": _SCALE}
        start("fiber_bus_bridge", "bridge", plane | bridge)
        start("fiber_planner", "planner", {})
        start("fiber_discretizer", "discretizer", {})
        start("fiber_recording", "recorder", {"folder": str(self._folder)})
        start("fiber_viewer", "viewer", {})
        self._client = PlaneClient(on_progress=self._on_progress, guard=self._guard)
        self._sent = self._client.collect(topics.TARGETS)
        self._truth = PlantTruth(self._socket, _COMPILE_S)
        self._others = Others(_WAIT_S)
        self._rng = np.random.default_rng([self._seed, 0])

    def _measure(self) -> None:
        self._operate()  # robots of a first motion whose loops compiled have stopped
        client, lasts_s = self._client, self._lasts_s
        begin_s = time.monotonic()
        stamp = client.send_targets(*self._new_targets())
        client.wait_until_ready(stamp, _COMPILE_S)
        ready_s = time.monotonic()
        client.start(_COMPILE_S)
        started_s = time.monotonic()
        client.wait_for_outcome(stamp, _COMPILE_S)
        planned_s = client.times[stamp].get("planner", ready_s)
        lasts_s["planning"] = planned_s - begin_s
        lasts_s["discretizing"] = max(ready_s - planned_s, 0.01)
        # load, verify and go; then the countdown
        lasts_s["loading"] = lasts_s["countdown"] = (started_s - ready_s) / 2
        lasts_s["moving"] = time.monotonic() - started_s

    def __exit__(self, *_: object) -> None:
        self._client.close()
        self._others.close()
        self._processes.end()

    def _guard(self) -> None:
        if time.monotonic() > self._back_s + _END_S:
            raise _Over

    # --- one run ---------------------------------------------------------------

    def run(self, number: int, **chosen: Any) -> _Line:
        """Do one run.

        Args:
            number: with the seed of the campaign it defines the run.
            chosen: `names`, `stage` or `how`, instead of those drawn.

        Returns:
            What was done; `counted`: the number of each event that must not happen; `unjudged`: the
            number of plans with an outcome whose robots could not be compared with their targets.
        """
        self._rng = np.random.default_rng([self._seed, number])
        line = self._draw(number) | chosen
        begin = self._truth.since(0)
        strike = threading.Thread(target=self._strike, args=[line], daemon=True)
        self._at = {line["stage"]: strike.start}
        outcome, line["ended"] = self._plan(line)
        self._at = {}
        if strike.ident is None:  # its stage never came
            line["missed"] = True
            strike.start()
        strike.join()
        assert "back_s" in line, "the strike was not carried out"
        self._back_s, line["unjudged"] = np.inf, 0
        first = 0 if self._is_new(line) else begin.next
        after = self._truth.since(first)
        unordered = after.controller > begin.bridge
        # the bridge that was killed before the client called start is not the one that it called
        ordered = self._is_new(line) or line.get("called_s", -np.inf) > line["back_s"]
        false_reached = self._count_false(outcome, after, line, line["how"] == "services")
        line["next_s"], then = self._recover(line)
        truth = self._truth.since(first)
        false_reached += self._count_false(then, truth, line)
        line["gone"] = [name for name in self._processes.ended() if name != _CLIENT]
        for name in line["gone"]:
            self._processes.restart(name)
        # movements that a plant took over from the plant before have no controller
        ran = ~(truth.moves.ended_s <= truth.moves.started_s)
        found = touching(self._client.plane, truth)
        line["counted"] = {
            "unverified": int((ran & ~truth.verified & (truth.controller > 0)).sum()),
            "unordered": 0 if ordered else int(unordered.sum()),
            "contacts": int(found.unsafe.sum()),
            "false_reached": false_reached,
            "no_end": int(line["ended"] == "nothing"),
            "slow_end": int("slow_s" in line),
            "late": int(line["next_s"] > _NEXT_S),
            "died": len(line["gone"]),
        }
        line["gap_mm"], line["movements"] = round(float(found.min_gap_mm), 4), int(ran.sum())
        line["memory"], line["load"] = self._processes.memory_mb(), round(os.getloadavg()[0], 1)
        if line["next_s"] >= GIVE_UP_S:
            self._keep_logs(line, "no next plan")
        return line

    def _keep_logs(self, line: _Line, why: str) -> None:
        """Copy the logs, with where each process is at work; the next graph writes others."""
        for name in self._processes.memory_mb():  # of those that run
            self._processes.send(name, signal.SIGUSR1)
        time.sleep(_DUMPED_S)
        folder = self._folder / f"{self._seed}-{line['number']} {why}"
        folder.mkdir(exist_ok=True)
        for log in self._folder.glob("*.log"):
            shutil.copy(log, folder)

    def _is_new(self, line: _Line) -> bool:
        """Whether the plant was killed, and counts its movements from zero."""
        return "plant" in line["names"] and line["how"] == "kill"

    def _draw(self, number: int) -> _Line:
        """The kind of a run: all pairs of process and stage in turn, killed and paused."""
        rng = self._rng
        kinds = [(p, s, h) for h in ("kill", "pause") for s in STAGES for p in PROCESSES]
        kinds += [("", "moving", "strangers"), ("", "moving", "services")] * 3
        kinds = [kind for kind in kinds if not self._only or {kind[0], kind[2]} & {*self._only}]
        order = np.random.default_rng([self._seed, 1, number // len(kinds)]).permutation(len(kinds))
        name, stage, how = kinds[order[number % len(kinds)]]
        names = [name] if name else []
        if how == "kill" and rng.random() < 0.2:
            names += [str(rng.choice([p for p in PROCESSES[:-1] if p != name]))]
        pause_s = rng.uniform(0.0, 0.5) if how == "kill" else 10 ** rng.uniform(-1.0, 0.5)
        return {
            "number": number, "names": names, "stage": stage, "how": how,
            "moment": round(rng.random(), 4), "pause_s": round(float(pause_s), 3),
            "services": rng.integers(len(SERVICES), size=OTHERS).tolist(),
        }  # fmt: skip

    def _strike(self, line: _Line) -> None:
        time.sleep(line["moment"] * self._lasts_s[line["stage"]])
        named: list[str] = [_CLIENT if each == "client" else each for each in line["names"]]
        names = [name for name in named if name not in self._processes.ended()]
        if line["how"] in ("strangers", "services"):
            others, services = self._others, line["services"]
            others.attack() if line["how"] == "strangers" else others.call(services)
        elif line["how"] == "kill":
            for name in names:
                self._processes.send(name, signal.SIGKILL)
            time.sleep(line["pause_s"])
            for name in reversed(names):
                if name != _CLIENT:
                    self._processes.restart(name)
        else:
            for what, then_s in ((signal.SIGSTOP, line["pause_s"]), (signal.SIGCONT, 0.0)):
                for name in names:
                    self._processes.send(name, what)
                time.sleep(then_s)
        self._back_s = line["back_s"] = time.monotonic()

    def _plan(self, line: _Line) -> tuple[PlanOutcome | None, str]:
        """Make a plan with the client; return its outcome, and how it ended for the client."""
        client, step, stamp = self._client, "", None
        try:
            if "client" in line["names"]:
                return self._plan_of_process(line)
            stamp = client.send_targets(*self._new_targets())
            line["stamp"] = stamp.ns
            self._enter("planning")
            client.wait_until_ready(stamp, _WAIT_S)
            step, line["called_s"] = "start", time.monotonic()
            self._enter("loading", "countdown")
            client.start(_WAIT_S)
            self._enter("moving")
            outcome = client.wait_for_outcome(stamp, _WAIT_S)
            self._enter("after")
            return outcome, "outcome"
        except (WaitError, _Over):  # without a stamp the client has sent no targets in time
            return (None, "unsent") if stamp is None else self._wait_for_end(stamp, line)
        except FiberError as error:
            line["refused"] = f"{step} {error}"[:200]
            return None, "refused"

    def _wait_for_end(self, stamp: PlanStamp, line: _Line) -> tuple[PlanOutcome | None, str]:
        """The outcome of a plan that lasts long: on a loaded machine late, not missing."""
        begin_s, self._back_s = time.monotonic(), np.inf
        try:
            outcome = self._client.wait_for_outcome(stamp, _NEVER_S)
        except WaitError:
            self._keep_logs(line, "no end")
            return None, "nothing"
        except FiberError as error:
            line["refused"] = str(error)[:200]
            return None, "refused"
        line["slow_s"] = round(_END_S + time.monotonic() - begin_s, 1)
        return outcome, "outcome"

    def _plan_of_process(self, line: _Line) -> tuple[PlanOutcome | None, str]:
        """The same by the command `reconfigure`, whose steps are seen from outside."""
        before = self._newest
        arguments = ["--timeout", f"{_WAIT_S:g}", f"random:{line['number']}"]
        self._processes.start_command("fiber_client", _CLIENT, arguments)
        self._client.wait_for(lambda: self._newest != before, _WAIT_S)
        stamp, line["stamp"] = self._newest, self._newest.ns
        try:
            return self._watch_process(stamp, line)
        except _Over:
            return self._wait_for_end(stamp, line)

    def _watch_process(self, stamp: PlanStamp, line: _Line) -> tuple[PlanOutcome | None, str]:
        client = self._client
        self._enter("planning")
        # a bridge that begins anew ends a plan without orders
        ready = lambda: "bridge" in client.times.get(stamp, {}) or stamp in client.outcomes  # noqa: E731
        client.wait_for(ready, _WAIT_S)
        self._enter("loading", "countdown")
        early = line["stage"] in STAGES[:4]  # a client that was killed may not have started
        try:
            started = lambda: client.moving or stamp in client.outcomes  # noqa: E731
            client.wait_for(started, 2.0 if early else _WAIT_S)
        except WaitError:
            return (None, "client gone") if early else self._wait_for_end(stamp, line)
        self._enter("moving")
        outcome = client.wait_for_outcome(stamp, _WAIT_S)
        self._enter("after")
        return outcome, "outcome"

    def _enter(self, *stages: str) -> None:
        for stage in stages:
            self._at.pop(stage, lambda: None)()

    def _on_progress(self, progress: Progress) -> None:
        if progress.session == self._client.session:
            self._newest = max(progress.attempt.plan, self._newest)
        if progress.stage == "planner" and progress.fraction >= 1.0:
            self._enter("discretizing")

    def _new_targets(self) -> tuple[np.ndarray, np.ndarray]:
        plane = self._client.plane
        drawn = random_field(plane, self._rng, start=self._client.angles).problem
        return plane.ids[drawn.asked], drawn.targets[drawn.asked]

    def _recover(self, line: _Line) -> tuple[float, PlanOutcome | None]:
        """Reconfigure as an operator would; return how long it took [s], and the outcome.

        The wait for the end of the plan before is not part of the time.
        """
        client, begin_s = self._client, time.monotonic()
        line["waited_s"], line["why"] = round(begin_s - line["back_s"], 2), []
        if self._is_new(line):
            self._operate()
        while time.monotonic() < begin_s + GIVE_UP_S:
            try:
                client.wait_for_graph(_WAIT_S)
                outcome = client.reconfigure(*self._new_targets(), _WAIT_S)
                if outcome.count(Outcome.REACHED) > len(outcome.ids) / 2:
                    return round(time.monotonic() - begin_s, 2), outcome
                line["why"].append(str(Counter(outcome.reason.tolist())))
            except FiberError as error:
                line["why"].append(str(error)[:200])
            self._operate()
        return GIVE_UP_S, None

    def _operate(self) -> None:
        for service in (topics.STOP, topics.CLEAR, topics.CONFIGURE):
            with suppress(FiberError):
                self._client.call_service(service, _WAIT_S)

    def _count_false(
        self, outcome: PlanOutcome | None, truth: Truth, line: _Line, moved_on: bool = False
    ) -> int:
        """As count_false; what it cannot tell, or not for robots that have moved on, is counted."""
        if outcome is None:
            return 0
        known = None
        if not moved_on:  # by the call of another client
            known = count_false(self._client.plane, outcome, self._sent, truth)
        del self._sent[:-_SENT_KEPT]
        line["unjudged"] += known is None
        return known or 0
