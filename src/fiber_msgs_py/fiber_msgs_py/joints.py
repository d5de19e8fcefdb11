"""Names of joints in messages: `p0042/theta` and `p0042/phi` are the joints of robot 42."""

import re

import numpy as np

from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.ids import checked_ids

__all__ = ["joint_columns", "joint_names"]

_JOINTS = {"theta": 0, "phi": 1}
_PATTERN = re.compile(r"p([0-9]{4}|[1-9][0-9]{4,9})/(theta|phi)")


def joint_names(ids, name: str) -> list[str]:
    """Return the names of both joints of each robot: theta, phi, theta, phi, ...

    Args:
        ids: robot ids, shape (n,).
        name: message they go into.

    Raises:
        MessageError: an id is out of range or there twice.
    """
    return [
        f"p{robot:04d}/{joint}" for robot in checked_ids(ids, name).tolist() for joint in _JOINTS
    ]


def joint_columns(names, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Find the robots that joint names speak of, and where each joint stands among them.

    Args:
        names: joint names in any order.
        name: message they are from.

    Returns:
        Robot ids, increasing, shape (n,), and the index of theta and phi of each robot
        among the names, shape (n, 2).

    Raises:
        MessageError: a name is malformed or there twice, or a robot has only one joint.
    """
    keys = np.empty(len(names), dtype=np.int64)
    for i, joint in enumerate(names):
        match = _PATTERN.fullmatch(joint)
        if match is None:
            raise MessageError(
                name, "is no joint name such as p0042/theta", field="joint", value=repr(joint)
            )
        keys[i] = 2 * int(match[1]) + _JOINTS[match[2]]
    order = np.argsort(keys, kind="stable")
    keys = keys[order]
    twice = np.flatnonzero(np.diff(keys) == 0)
    if twice.size:
        robot = int(keys[twice[0]]) // 2
        raise MessageError(
            name, "is there twice", field="joint", robot=robot, value=names[order[twice[0]]]
        )
    ids, first, counts = np.unique(keys // 2, return_index=True, return_counts=True)
    if np.any(counts != 2):
        at = int(np.argmax(counts != 2))
        raise MessageError(
            name, "comes alone", field="joint", robot=int(ids[at]), value=names[order[first[at]]]
        )
    checked_ids(ids, name)
    return ids, order.reshape(-1, 2)
