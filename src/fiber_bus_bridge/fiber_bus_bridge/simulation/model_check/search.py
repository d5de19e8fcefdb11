# SPDX-License-Identifier: Apache-2.0
"""Exhaustive search through the protocol: every choice of fates and mishaps, within a bound."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, TypeAlias

from fiber_bus_bridge.protocol import State
from fiber_bus_bridge.simulation.model_check.choices import Choices
from fiber_bus_bridge.simulation.model_check.system import Scenario, System

__all__ = ["Search", "explore"]

_MOST_STEPS = 500  # a plan that has not ended after so many steps counts as endless
_Trace: TypeAlias = tuple["_Trace", str] | None


class _Node(NamedTuple):
    """A system in the search, with the faults left and the way that led to it."""

    system: System
    key: int
    faults: int
    trace: _Trace
    before: "_Node | None"
    steps: int = 0

    def endless(self) -> bool:
        """Whether the system was in this state before, on this way, without a fault since."""
        node = self.before
        while node is not None and node.faults == self.faults:
            if node.key == self.key:
                return True
            node = node.before
        return self.steps > _MOST_STEPS


@dataclass
class Search:
    """Result of a search.

    Args:
        states: number of different states.
        steps: number of steps of the protocol that were run.
        ends: number of different ends, by the state of the protocol.
        visited: states of the protocol that were visited.
        apart_s: longest time between the stops of robots that were stopped together [s].
        wrong: rules that were broken, each with the faults that led to it.
        complete: whether all states within the bound were visited.
    """

    states: int = 0
    steps: int = 0
    ends: Counter[str] = field(default_factory=Counter)
    visited: set[State] = field(default_factory=set)
    apart_s: float = 0.0
    wrong: list[str] = field(default_factory=list)
    complete: bool = True


def explore(
    scenario: Scenario, faults: int, most_steps: int | None = None, most_wrong: int = 1
) -> Search:
    """Visit every state that a plan can reach with a number of faults.

    The search is depth-first. A state that was visited with as many faults left is not visited
    again.

    Args:
        scenario: where it begins.
        faults: largest number of faults.
        most_steps: steps of the protocol after which the search ends incomplete; None for all.
        most_wrong: broken rules after which the search ends.
    """
    search, seen = Search(), dict[int, int]()
    system = System.begin(scenario)
    todo = [_Node(system, system.key(), faults, None, None)]
    while todo:
        for child in _children(todo.pop()):
            search.steps += 1
            _record(search, child)
            if seen.get(child.key, -1) >= child.faults or child.steps > _MOST_STEPS:
                if child.endless():
                    search.wrong.append(_story("does not end", child.trace))
            else:
                if child.key not in seen:
                    search.states += 1
                    if child.system.ended:
                        search.ends[child.system.c.state.name] += 1
                seen[child.key] = child.faults
                if not child.system.ended and not child.system.truth.wrong:
                    todo.append(child)
            if len(search.wrong) >= most_wrong or search.steps == most_steps:
                search.complete = False
                return search
    return search


def _record(search: Search, node: _Node) -> None:
    system = node.system
    search.visited.add(system.c.state)
    search.apart_s = max(search.apart_s, system.truth.apart_s)
    search.wrong += [_story(wrong, node.trace) for wrong in system.truth.wrong]


def _children(node: _Node) -> Iterator[_Node]:
    """Yield a state for each combination of choices in the next step."""
    todo: list[dict[int, int]] = [{}]
    while todo:
        forced = todo.pop()
        system, choices = node.system.clone(), Choices(forced)
        state = node.system.c.state.name
        system.step(choices)
        faults = node.faults - len(forced)
        trace = node.trace
        for words in choices.words:
            trace = (trace, f"{state}: {words}")
        yield _Node(system, system.key(), faults, trace, node, node.steps + 1)
        if faults:
            first = max(forced, default=-1) + 1
            for number in range(first, len(choices.options)):
                todo += [{**forced, number: k} for k in range(1, choices.options[number])]


def _story(wrong: str, trace: _Trace) -> str:
    """The broken rule, after the faults that led to it."""
    words = [wrong]
    while trace is not None:
        trace, last = trace
        words.append(last)
    return "; ".join(reversed(words))
