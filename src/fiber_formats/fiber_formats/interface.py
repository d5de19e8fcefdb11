# SPDX-License-Identifier: Apache-2.0
"""What a format is: a name, a test of the content, and a reader for each kind of data it holds."""

from collections.abc import Callable
from dataclasses import dataclass

from fiber_formats.records import LayoutColumns, StartColumns, TargetColumns
from fiber_formats.source import Source

__all__ = ["Format"]


@dataclass(frozen=True)
class Format:
    """One kind of file, or of files that belong together.

    Args:
        name: how messages call it, as "DESI state".
        matches: whether a source is of this format, judged by its content; raises nothing.
        layout: reads the robots, or None where the format has none.
        starts: reads present angles, or None.
        targets: reads targets, or None.
        signs: columns by which its tables are recognised, for each kind of table: a file that has
            most of them, and not all, is refused with the names of those that it lacks.

    The readers raise FormatError for what they refuse.
    """

    name: str
    matches: Callable[[Source], bool]
    layout: Callable[[Source], LayoutColumns] | None = None
    starts: Callable[[Source], StartColumns] | None = None
    targets: Callable[[Source], TargetColumns] | None = None
    signs: tuple[tuple[str, ...], ...] = ()

    @property
    def holds(self) -> str:
        """The kinds of data that the format holds, in words."""
        kinds = [name for name in ("layout", "starts", "targets") if getattr(self, name)]
        return " and ".join(kinds) or "nothing"
