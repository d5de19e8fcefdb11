"""Read-only arrays of a known shape and kind, checked once where values come in."""

import numpy as np

__all__ = ["frozen_array"]


def frozen_array(value, dtype, shape, name: str, error: type[Exception]) -> np.ndarray:
    """Return a value as a read-only C-ordered array, or refuse it.

    What nobody can write to is shared, anything else is copied.

    Args:
        value: anything numpy makes an array of.
        dtype: float, int or bool. Whole numbers may come as floats, flags as 0 and 1;
            nothing is rounded.
        shape: expected length of each axis, None where any length will do.
        name: what to call the value in a message.
        error: exception to raise.

    Raises:
        error: wrong shape, or an element is not of the kind asked for.
    """
    try:
        raw = np.asarray(value)
        if raw.dtype.kind not in "biuf":
            raise ValueError(f"it holds {raw.dtype} values")
        kept = np.dtype(np.int64 if dtype is int else dtype)
        if _is_frozen(raw) and raw.dtype == kept and raw.flags.c_contiguous:
            result = raw
        else:
            result = np.array(raw, dtype=float, order="C") if dtype is float else _exact(raw, dtype)
    except (TypeError, ValueError) as reason:
        raise error(f"{name} is not an array of {np.dtype(dtype).name}: {reason}") from None
    if result.ndim != len(shape) or any(
        want is not None and want != got for want, got in zip(shape, result.shape)
    ):
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise error(f"{name} has shape {result.shape}, expected ({wanted})")
    result.setflags(write=False)
    return result


def _is_frozen(array):
    # neither this array nor the one it is a view of can be written to
    base = array if array.base is None else array.base
    return type(base) is np.ndarray and not (array.flags.writeable or base.flags.writeable)


def _exact(raw, dtype):
    if raw.dtype.kind == "f":
        fits = np.isfinite(raw) & (raw == np.rint(raw)) & (np.abs(raw) < 2.0**53)
        if not fits.all():
            raise ValueError(f"{raw[~fits][0]} is not a whole number")
    if np.dtype(dtype) == bool and not np.isin(raw, (0, 1)).all():
        raise ValueError(f"{raw[~np.isin(raw, (0, 1))][0]} is neither true nor false")
    return np.array(raw, dtype=bool if np.dtype(dtype) == bool else np.int64, order="C")
