# SPDX-License-Identifier: Apache-2.0
"""Names of joints in messages: `p0042/theta` and `p0042/phi` are the joints of robot 42."""

import re
from collections.abc import Iterable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from fiber_core.array_types import Ids, Ints
from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids
from fiber_msgs_py.sessions import is_session

__all__ = ["joint_columns", "joint_names"]

_JOINTS = {"theta": 0, "phi": 1}
_KEPT = 4  # lists of names; a plane has the same one in each of its messages
_PATTERN = re.compile(r"p([0-9]{4}|[1-9][0-9]{4,9})/(theta|phi)")


def joint_names(ids: ArrayLike, name: str) -> list[str]:
    """Return the names of both joints of each robot: theta, phi, theta, phi, ...

    Args:
        ids: robot ids, shape (n,).
        name: name of the message in an error.

    Raises:
        MessageError: an id is out of range or appears twice.
    """
    return list(_names(checked_ids(ids, name).tobytes()))


@lru_cache(_KEPT)
def _names(ids: bytes) -> tuple[str, ...]:
    robots = np.frombuffer(ids, dtype=np.int64).tolist()
    return tuple(f"p{robot:04d}/{joint}" for robot in robots for joint in _JOINTS)


def joint_columns(names: Iterable[str], name: str) -> tuple[Ids, Ints]:
    """Return the robots of some joint names, and the place of each joint among the names.

    Args:
        names: joint names in any order; ids of sessions among them are no joints.
        name: name of the message in an error.

    Returns:
        Robot ids, increasing, shape (n,), and the index of theta and phi of each robot
        among the names, shape (n, 2); both cannot be written to, as they are kept.

    Raises:
        MessageError: a name is malformed or appears twice, or a robot has only one joint.
    """
    return _columns(tuple(names), name)


@lru_cache(_KEPT)
def _columns(names: tuple[str, ...], name: str) -> tuple[Ids, Ints]:
    place = [i for i, each in enumerate(names) if not is_session(each)]
    names = tuple(names[i] for i in place)
    keys = np.empty(len(names), dtype=np.int64)
    for i, joint in enumerate(names):
        match = _PATTERN.fullmatch(joint)
        if match is None:
            raise MessageError(
                name, "is not a joint name such as p0042/theta", field="joint", value=repr(joint)
            )
        keys[i] = 2 * int(match[1]) + _JOINTS[match[2]]
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    twice = np.flatnonzero(np.diff(keys) == 0)
    if twice.size:
        robot = int(keys[twice[0]]) // 2
        raise MessageError(
            name, "appears twice", field="joint", robot=robot, value=names[int(order[twice[0]])]
        )
    ids, first, counts = np.unique(keys // 2, return_index=True, return_counts=True)
    if np.any(counts != 2):
        at = int(np.argmax(counts != 2))
        only = names[int(order[first[at]])]
        other = "phi" if only.endswith("theta") else "theta"
        problem = f"has no matching {other} joint"
        raise MessageError(name, problem, field="joint", robot=int(ids[at]), value=only)
    checked_ids(ids, name)
    columns = np.array(place, dtype=np.int64)[order].reshape(-1, 2)
    for each in (ids, columns):
        each.flags.writeable = False
    return ids, columns
