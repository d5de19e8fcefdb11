# SPDX-License-Identifier: Apache-2.0
"""Read-only arrays of a known shape and kind, checked once where values enter."""

from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["frozen_array"]

_Kind = TypeVar("_Kind", np.float64, np.int64, np.bool_)

_LARGEST_EXACT = 2.0**53  # above it, a float may stand for several whole numbers


def frozen_array(
    value: ArrayLike,
    dtype: type[_Kind],
    shape: Sequence[int | None],
    name: str,
    error: type[Exception],
) -> NDArray[_Kind]:
    """Return a value as a read-only C-ordered array, or refuse it.

    An array to which nothing can be written is shared; any other value is copied.

    Args:
        value: anything that numpy makes an array of.
        dtype: np.float64, np.int64 or np.bool_. Whole numbers may come as floats, flags as
            0 and 1; nothing is rounded.
        shape: expected length of each axis, None where any length is allowed.
        name: name of the value in a message.
        error: exception to raise.

    Raises:
        error: the shape is wrong, or an element is not of this kind.
    """
    try:
        raw = np.asarray(value)
        if raw.dtype.kind not in "biuf":
            raise ValueError(f"it holds {raw.dtype} values")
        if _is_frozen(raw) and raw.dtype == dtype and raw.flags.c_contiguous:
            result = raw
        else:
            if np.dtype(dtype).kind != "f":
                _check_exact(raw, is_flag=np.dtype(dtype).kind == "b")
            result = np.array(raw, dtype=dtype, order="C")
    except (TypeError, ValueError) as problem:
        raise error(f"{name} is not an array of {np.dtype(dtype).name}: {problem}") from None
    if result.ndim != len(shape) or any(
        want is not None and want != got for want, got in zip(shape, result.shape)
    ):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise error(f"{name} has shape {result.shape}, expected ({wanted})")
    result.setflags(write=False)
    return result


def _is_frozen(array: NDArray[Any]) -> bool:
    # neither this array nor the one it is a view of can be written to
    base = array if array.base is None else array.base
    return type(base) is np.ndarray and not (array.flags.writeable or base.flags.writeable)


def _check_exact(raw: NDArray[Any], is_flag: bool) -> None:
    # refuses an element that is not a whole number, or not a flag
    if raw.dtype.kind == "f":
        fits = np.isfinite(raw) & (raw == np.rint(raw)) & (np.abs(raw) < _LARGEST_EXACT)
        if not fits.all():
            raise ValueError(f"{raw[~fits][0]} is not a whole number")
    if is_flag:
        fits = np.isin(raw, (0, 1))
        if not fits.all():
            raise ValueError(f"{raw[~fits][0]} is neither true nor false")
