# SPDX-License-Identifier: Apache-2.0
"""Command line arguments: lists and ranges of numbers, and errors in one line."""

import argparse
from collections.abc import Callable
from difflib import get_close_matches
from typing import NoReturn, TypeVar

import numpy as np

__all__ = [
    "HelpFormatter",
    "Parser",
    "arm_pairs",
    "length",
    "names",
    "numbers",
    "positive",
    "share",
    "whole_numbers",
]

_MOST_VALUES = 1000  # of one range, against a slip in its step

T = TypeVar("T")


class HelpFormatter(argparse.RawDescriptionHelpFormatter):
    """Help with examples as they are written, and with the defaults that say something."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        shown = isinstance(action.default, str | int | float) and action.default is not False
        if not shown or action.default == argparse.SUPPRESS or not action.help:
            return action.help
        return f"{action.help} (default %(default)s)"


class Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line and exits with code 2."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")

    def refuse_unknown(self, rest: list[str]) -> None:
        """Report the first argument that no option took, with an option of a similar name."""
        if not rest:
            return
        known = [name for action in self._actions for name in action.option_strings]
        unknown = rest[0].partition("=")[0]
        similar = get_close_matches(unknown, known, n=1)
        what = "option" if unknown.startswith("-") else "argument"
        hint = f", similar is {similar[0]}" if similar else ""
        self.error(f"unknown {what} {unknown}{hint}")


def positive(text: str) -> int:
    """Read one positive whole number.

    Raises:
        argparse.ArgumentTypeError: the text is no positive whole number; names it.
    """
    value = _number(text)
    if value != int(value) or value < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive whole number")
    return int(value)


def length(text: str) -> float:
    """Read a length of 0 or more.

    Raises:
        argparse.ArgumentTypeError: the text is no such number; names it.
    """
    value = _number(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text!r} is less than 0")
    return value


def share(text: str) -> float:
    """Read a share above 0, at most 1.

    Raises:
        argparse.ArgumentTypeError: the text is no such number; names it.
    """
    value = _number(text)
    if not 0.0 < value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not above 0 and at most 1")
    return value


def numbers(text: str) -> list[float]:
    """Read "5.0,5.5" or "5:7:0.5", the end included; parts of both kinds may be mixed.

    Raises:
        argparse.ArgumentTypeError: a part is neither a number nor a range; names it.
    """
    return _unique(text, lambda part: _range(part) if ":" in part else [_number(part)])


def whole_numbers(text: str) -> list[int]:
    """Read whole numbers, written as for `numbers`.

    Raises:
        argparse.ArgumentTypeError: a part is no whole number; names it.
    """
    values = numbers(text)
    for value in values:
        if value != int(value):
            raise argparse.ArgumentTypeError(f"{value:g} is not a whole number")
    return [int(value) for value in values]


def arm_pairs(text: str) -> list[tuple[float, float]]:
    """Read lengths of both arms: "3x2.5,3.5" is 3 and 2.5 mm, then 3.5 mm for both.

    Raises:
        argparse.ArgumentTypeError: a part is neither a length, a pair nor a range; names it.
    """

    def pairs(part: str) -> list[tuple[float, float]]:
        if "x" in part:
            first, _, second = part.partition("x")
            return [(_number(first), _number(second))]
        return [(value, value) for value in (_range(part) if ":" in part else [_number(part)])]

    return _unique(text, pairs)


def names(known: tuple[str, ...]) -> Callable[[str], list[str]]:
    """Return a reader of names that are separated by commas, each one of those known."""

    def read(text: str) -> list[str]:
        chosen = _unique(text, lambda part: [part])
        for name in chosen:
            if name not in known:
                raise argparse.ArgumentTypeError(f"{name!r} is not one of {', '.join(known)}")
        return chosen

    return read


def _unique(text: str, read: Callable[[str], list[T]]) -> list[T]:
    values = [value for part in text.split(",") for value in read(part.strip())]
    return list(dict.fromkeys(values))


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number") from None
    if not np.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not finite")
    return value


def _range(text: str) -> list[float]:
    parts = [_number(part) for part in text.split(":")]
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"{text!r} is not a range BEGIN:END:STEP")
    begin, end, step = parts
    if step <= 0 or end < begin or (end - begin) / step > _MOST_VALUES:
        raise argparse.ArgumentTypeError(
            f"range {text!r}: END must be at least BEGIN, and STEP positive and not tiny"
        )
    count = int(np.floor((end - begin) / step + 1e-9)) + 1
    return [round(begin + k * step, 9) for k in range(count)]
