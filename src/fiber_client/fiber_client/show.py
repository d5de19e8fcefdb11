# SPDX-License-Identifier: Apache-2.0
"""Print a topic of the graph as a table: outcome, layout, targets, segments, held or measured.

The newest message is shown: the last one that was published, and of targets, of which none is kept,
the next one. Codes are printed as words; docs/codes.md has their numbers. Quantities have the units
of the topic: m, rad, s, and ticks and wire units in segments. Exit code 0: a message was shown.
"""

import argparse
import csv
import json
import sys
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import Any

import numpy as np
from rclpy.qos import DurabilityPolicy
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import PointCloud2, PointField

from fiber_client.terminal import table
from fiber_core.errors import FiberError
from fiber_core.outcomes import Outcome, Reason, Verdict
from fiber_msgs_py import PlanStamp, Stage, topics
from fiber_msgs_py.layout import RowKind
from fiber_msgs_py.sessions import is_session
from fiber_node import RosClient
from fiber_node.ros_environment import use_loopback

__all__ = ["CODES", "main", "rows_of"]

CODES: dict[tuple[str, str], type[IntEnum]] = {
    ("outcome", "outcome"): Outcome,
    ("outcome", "reason"): Reason,
    ("held", "reason"): Reason,
    ("held", "stage"): Stage,
    ("layout", "kind"): RowKind,
    ("measured", "verdict"): Verdict,
}
_TOPICS = {
    "outcome": (topics.OUTCOME,),
    "layout": (topics.LAYOUT,),
    "targets": (topics.TARGETS,),
    "segments": (topics.SEGMENTS,),
    "held": (topics.HELD_BY_PLANNER, topics.HELD_BY_DISCRETIZER),
    "measured": (topics.MEASURED,),
}
_UNITS = {"segments": "ticks and wire units"}  # of the table; else SI
_TYPES = {
    PointField.INT8: "i1",
    PointField.UINT8: "u1",
    PointField.INT16: "i2",
    PointField.UINT16: "u2",
    PointField.INT32: "i4",
    PointField.UINT32: "u4",
    PointField.FLOAT32: "f4",
    PointField.FLOAT64: "f8",
}
_SETTLED_S = 0.5  # without another message the newest one has come

_Row = dict[str, Any]


def rows_of(name: str, message: PointCloud2) -> list[_Row]:
    """Return the rows of a table message by column, codes as words.

    Args:
        name: the topic, as main has it.
        message: the message.
    """
    fields = [field for field in message.fields if not is_session(field.name)]
    order = ">" if message.is_bigendian else "<"
    dtype = np.dtype(
        {
            "names": [field.name for field in fields],
            "formats": [(order + _TYPES[field.datatype], (field.count,)) for field in fields],
            "offsets": [field.offset for field in fields],
            "itemsize": message.point_step,
        }
    )
    rows = np.frombuffer(message.data, dtype)
    columns = {}
    for field in fields:
        values = rows[field.name].tolist()
        code = CODES.get((name, field.name))
        if field.count == 1:
            values = [value[0] for value in values]
        columns[field.name] = values if code is None else [_word(code, each) for each in values]
    return [dict(zip(columns, row)) for row in zip(*columns.values())]


def _word(code: type[IntEnum], value: int) -> str:
    return code(value).name.lower() if value in set(code) else str(value)


def main(argv: Sequence[str] | None = None) -> int:
    """Show one topic; return the exit code."""
    options = _parser().parse_args(remove_ros_args(sys.argv if argv is None else argv)[1:])
    use_loopback()
    try:
        with RosClient("show", args=argv) as client:
            messages = _newest(client, options.topic, options.timeout)
    except FiberError as error:
        print(f"show: {error}", file=sys.stderr)
        return 1
    plan = max(map(PlanStamp.of, messages))
    rows = [
        row
        for message in messages
        if PlanStamp.of(message) == plan
        for row in rows_of(options.topic, message)
    ]
    try:
        _print(rows, plan, options.format, _UNITS.get(options.topic, "m, rad and s"))
        sys.stdout.flush()
    except BrokenPipeError:  # `show layout | head`
        sys.stderr.close()
    return 0


def _newest(client: RosClient, name: str, timeout_s: float) -> list[PointCloud2]:
    """Return the newest message of each topic of a name that has one."""
    received = [client.collect(topic) for topic in _TOPICS[name]]
    names = " or ".join(client.node.resolve_topic_name(topic.name) for topic in _TOPICS[name])
    kept = all(t.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for t in _TOPICS[name])
    what = f"a message of {names}{'' if kept else ', of which none is kept,'}"
    client.wait_for(lambda: any(received), timeout_s, what)
    client.wait_quietly(_SETTLED_S, lambda: sum(map(len, received)))
    return [max(messages, key=PlanStamp.of) for messages in received if messages]


def _print(rows: list[_Row], plan: PlanStamp, form: str, units: str) -> None:
    if form == "json":
        print(json.dumps({"stamp": str(plan), "rows": _finite(rows)}))
    elif form == "csv":
        writer = csv.DictWriter(sys.stdout, list(rows[0]) if rows else [], lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    else:
        lines: list[Sequence[object]] = [list(rows[0])] if rows else []
        lines += [[_cell(value) for value in row.values()] for row in rows]
        print(f"stamp {plan}, in {units}, {len(rows)} rows")
        if lines:
            print(table(lines))


def _finite(rows: Iterable[_Row]) -> list[_Row]:
    # JSON has no nan
    return [{key: None if value != value else value for key, value in row.items()} for row in rows]


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list):
        return " ".join(map(_cell, value))
    return str(value)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="show", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("topic", choices=list(_TOPICS), metavar="TOPIC", help="|".join(_TOPICS))
    parser.add_argument(
        "--format", choices=("table", "csv", "json"), default="table", help="table, csv or json"
    )
    parser.add_argument(
        "--timeout", type=float, default=10.0, metavar="S", help="time-out of the wait [s], 10"
    )
    return parser
