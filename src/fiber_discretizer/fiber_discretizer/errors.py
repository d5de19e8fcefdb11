# SPDX-License-Identifier: Apache-2.0
"""Errors of the discretizer."""

from collections.abc import Iterable

from fiber_core.errors import FiberError

__all__ = ["OptionError", "UnknownOption"]

# names that options had before
_RENAMED = {"turns": "sequential", "halves": "makarem2014", "paper": "douglas_peucker"}


class OptionError(FiberError):
    """A number among the options of the discretizer is out of its range."""


class UnknownOption(FiberError):
    """An option has a value that the discretizer does not know.

    Args:
        option: name of the option.
        value: its value.
        known: the values that the option can have.
    """

    def __init__(self, option: str, value: object, known: Iterable[object]):
        self.option, self.value, self.known = option, value, tuple(known)
        text = f"{option} {value!r} is not one of {', '.join(map(str, self.known))}"
        new = _RENAMED.get(value) if isinstance(value, str) else None
        if new in self.known:
            text += f"; {value!r} is now called {new!r}"
        super().__init__(text)
