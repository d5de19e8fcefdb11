# SPDX-License-Identifier: Apache-2.0
"""Tables of numbers as PointCloud2: one row for each point, named columns, read without a copy."""

import array

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField

from fiber_msgs_py.errors import MessageError
from fiber_msgs_py.sessions import checked_session
from fiber_msgs_py.stamps import PlanStamp, check_frame, header

__all__ = ["column_names", "decode_table", "encode_table"]

_CODES = {
    np.dtype(kind): code
    for kind, code in (
        ("<i1", PointField.INT8),
        ("<u1", PointField.UINT8),
        ("<i2", PointField.INT16),
        ("<u2", PointField.UINT16),
        ("<i4", PointField.INT32),
        ("<u4", PointField.UINT32),
        ("<f4", PointField.FLOAT32),
        ("<f8", PointField.FLOAT64),
    )
}
_NAMES = {code: dtype.name for dtype, code in _CODES.items()}
# bytes of a row; numpy refuses 2**31, and a table without rows has no data to bound its columns
_LONGEST_ROW = 2**24


def encode_table(rows: np.ndarray, stamp: PlanStamp, session: str | None = None) -> PointCloud2:
    """Return a table as a message.

    Args:
        rows: structured array of little-endian columns, shape (n,); a column may hold an
            array in each row, but not an empty one.
        stamp: names the plan.
        session: id of the session that the table belongs to, a field more; None for no session.
    """
    fields = []
    offsets = {str(name): field[1] for name, field in (rows.dtype.fields or {}).items()}
    for name in column_names(rows):
        dtype = rows.dtype[name]
        fields.append(
            PointField(
                name=name,
                offset=offsets[name],
                datatype=_CODES[dtype.base],
                count=int(np.prod(dtype.shape, dtype=int)),
            )
        )
    if session is not None:
        fields.append(PointField(name=checked_session(session), datatype=PointField.UINT8, count=1))
    return PointCloud2(
        header=header(stamp),
        height=1,
        width=len(rows),
        fields=fields,
        is_bigendian=False,
        point_step=rows.dtype.itemsize,
        row_step=rows.nbytes,
        data=array.array("B", rows.tobytes()),  # any other type costs a Python object per byte
        is_dense=True,
    )


def decode_table(
    message: PointCloud2, name: str, columns: dict[str, str], lists: dict[str, str] | None = None
) -> np.ndarray:
    """Return some columns of a message as a read-only view.

    Columns may have any order and any offset; other columns are ignored.

    Args:
        message: the message; its bytes are shared, not copied.
        name: name of the message in an error.
        columns: numpy type of each required column, by name; one value in each row.
        lists: numpy type of each optional column, by name; any number of values in each row.
            An absent one is left out of the result.

    Returns:
        Structured array, shape (n,).

    Raises:
        MessageError: another frame, big-endian, a column missing or of another type or
            count, or sizes that contradict each other; names the field and its value.
    """
    check_frame(message, name)
    if message.is_bigendian:
        raise MessageError(name, "is not supported", field="is_bigendian", value=True)
    found = {}
    for field in message.fields:
        if field.name in found:
            raise MessageError(name, "appears twice", field="field", value=field.name)
        found[field.name] = field
    if message.point_step > _LONGEST_ROW:
        raise MessageError(
            name,
            f"bytes, expected at most {_LONGEST_ROW}",
            field="point_step is",
            value=message.point_step,
        )
    dtype = _row_type(found, name, columns, lists or {}, message.point_step)
    rows = message.width * message.height
    for size, value, expected in (
        ("row_step", message.row_step, message.width * message.point_step),
        ("data", len(message.data), rows * message.point_step),
    ):
        if value != expected:
            raise MessageError(
                name, f"bytes, expected {expected}", field=f"size of {size} is", value=value
            )
    view = np.frombuffer(message.data, dtype, rows) if rows else np.zeros(0, dtype)
    view.flags.writeable = False
    return view


def column_names(rows: np.ndarray) -> tuple[str, ...]:
    """Return the names of the columns of a structured array."""
    return rows.dtype.names or ()


def _row_type(
    found: dict[str, PointField],
    name: str,
    columns: dict[str, str],
    lists: dict[str, str],
    point_step: int,
) -> np.dtype:
    names, formats, offsets = [], [], []
    for column, kind in (columns | lists).items():
        field = found.get(column)
        if field is None:
            if column in lists:
                continue
            raise MessageError(name, "is missing", field="field", value=column)
        dtype = np.dtype(kind)
        if field.datatype != _CODES[dtype]:
            got = _NAMES.get(field.datatype, f"datatype {field.datatype}")
            raise MessageError(name, f"is not {dtype.name}", field=f"field {column}:", value=got)
        if field.count < 1 or (column in columns and field.count != 1):
            raise MessageError(
                name,
                "values in each row, expected " + ("1" if column in columns else "at least 1"),
                field=f"field {column} has",
                value=field.count,
            )
        end = field.offset + field.count * dtype.itemsize
        if end > point_step:
            raise MessageError(
                name,
                f"is less than the {end} bytes that field {column} needs",
                field="point_step",
                value=point_step,
            )
        names.append(column)
        formats.append(dtype if column in columns else (dtype, (field.count,)))
        offsets.append(field.offset)
    return np.dtype(
        {"names": names, "formats": formats, "offsets": offsets, "itemsize": point_step}
    )
