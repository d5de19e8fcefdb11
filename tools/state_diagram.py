#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Draw the states of the controller's protocol, from their table, into docs/protocol.md.

Between two marker lines of that page stand a Mermaid state diagram and the tables of states and
events; this command writes them anew, or with --check says whether they are up to date. The diagram
leaves out ENABLE, which changes no state, and ERROR, which every step of a plan may end with.
"""

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path += [str(path) for path in sorted((ROOT / "src").glob("fiber_*"))]

from fiber_bus_bridge.protocol import STEPS, TRANSITIONS, Event, State  # noqa: E402

__all__ = ["fresh", "main"]

PAGE = ROOT / "docs" / "protocol.md"
BEGIN, END = "<!-- begin: tools/state_diagram.py -->", "<!-- end: tools/state_diagram.py -->"
_NOT_DRAWN = (Event.ERROR, Event.ENABLE)


def diagram() -> str:
    """Return the transitions as a Mermaid state diagram."""
    lines = ["```mermaid", "stateDiagram-v2", "    [*] --> UNCONFIGURED"]
    labels: dict[tuple[State, State], list[str]] = {}
    for (state, event), after in TRANSITIONS.items():
        if event not in _NOT_DRAWN:
            labels.setdefault((state, after), []).append(event.name)
    for (state, after), events in labels.items():
        lines.append(f"    {state.name} --> {after.name}: {', '.join(events)}")
    return "\n".join([*lines, "```"])


def tables() -> str:
    """Return the states and the events as tables in markdown."""
    lines = ["| state | what is done or awaited in it | function | events |", "|---|---|---|---|"]
    for state in State:
        step = STEPS.get(state)
        function = "" if step is None else f"`{step.__module__.split('.')[-1]}.{step.__name__}`"
        events = ", ".join(event.name for known, event in TRANSITIONS if known is state)
        lines.append(f"| {state.name} | {state.value} | {function} | {events} |")
    lines += ["", "| event | when |", "|---|---|"]
    lines += [f"| {event.name} | {event.value} |" for event in Event]
    return "\n".join(lines)


def fresh(text: str) -> str:
    """Return the text of the page with the diagram and the tables made anew."""
    head, rest = text.split(BEGIN)
    return f"{head}{BEGIN}\n{diagram()}\n\n{tables()}\n{END}{rest.split(END)[1]}"


def main(argv: list[str] | None = None) -> int:
    """Write the page, or check it; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; 1 if it is stale")
    options = parser.parse_args(argv)
    text = PAGE.read_text(encoding="utf-8")
    new = fresh(text)
    if options.check:
        if new != text:
            print(f"{PAGE} is stale: run tools/state_diagram.py", file=sys.stderr)
        return int(new != text)
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
