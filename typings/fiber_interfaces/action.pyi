# SPDX-License-Identifier: Apache-2.0
from collections.abc import Sequence
from typing import Any

from builtin_interfaces.msg import Time

class Reconfigure:
    Impl: Any

    class Goal:
        ids: Sequence[int]
        x: Sequence[float]
        y: Sequence[float]
        plan_only: bool
        timeout: float

    class Result:
        plan: Time
        ids: Sequence[int]
        outcome: Sequence[int]
        reason: Sequence[int]
        error: Sequence[float]
        message: str

    class Feedback:
        stage: str
        fraction: float
        text: str
        def __init__(self, *, stage: str, fraction: float, text: str) -> None: ...
