# SPDX-License-Identifier: Apache-2.0
"""Columns that tell which robots are out of use, in either sense; doubtful ones are refused."""

from fiber_core.array_types import Bools
from fiber_formats.columns import Columns

__all__ = ["DISABLED", "ENABLED", "enabled_of", "refuse_doubtful_flags"]

ENABLED, DISABLED = ("enabled", "functional"), ("nonfunctional", "disabled")


def enabled_of(columns: Columns) -> Bools | None:
    """Return which robots may be moved, shape (rows,); None where no column tells.

    A robot may be moved if every such column allows it.
    """
    enabled = None
    for name in (*ENABLED, *DISABLED):
        if name in columns:
            value = columns.flags(name)
            value = ~value if name in DISABLED else value
            enabled = value if enabled is None else enabled & value
    return enabled


def refuse_doubtful_flags(columns: Columns) -> None:
    """Note the columns never asked for that may tell which robots are out of use."""
    if doubtful := columns.flag_names():
        columns.note(
            f"{', '.join(doubtful)} may tell which robots are out of use: call it enabled or "
            "disabled, or leave it out"
        )
