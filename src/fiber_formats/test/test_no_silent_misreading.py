# SPDX-License-Identifier: Apache-2.0
"""A table with columns renamed, dropped, reordered or encoded anew is never misread in silence.

Each drawn damage leaves one of three: the very same plane, a refusal, or a plane that lacks exactly
what a notice or the summary names.
"""

import gzip
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fiber_core.presets import preset
from fiber_formats import FormatError, read_layout, read_targets

N = 7
RNG = np.random.default_rng(11)
CENTERS = preset("desi", N).centers
COLUMNS = {
    "id": [str(i) for i in (31, 6, 17, 2, 24, 4294967295, 12)],
    "x_mm": [repr(float(x)) for x in CENTERS[:, 0]],
    "y_mm": [repr(float(y)) for y in CENTERS[:, 1]],
    "arm_theta_mm": [repr(float(v)) for v in RNG.normal(3.0, 0.02, N)],
    "arm_phi_mm": [repr(float(v)) for v in RNG.normal(3.0, 0.02, N)],
    "theta_zero_deg": [repr(float(v)) for v in RNG.uniform(-180, 180, N)],
    "phi_range_deg": [repr(float(v)) for v in RNG.uniform(180, 190, N)],
    "enabled": ["True", "False", "True", "True", "False", "True", "True"],
    "bus": ["1", "1", "2", "2", "3", "3", "3"],
}
FIELDS = {  # what of a plane comes from which column
    "id": "ids",
    "arm_theta_mm": "arms",
    "arm_phi_mm": "arms",
    "theta_zero_deg": "limits",
    "phi_range_deg": "limits",
    "enabled": "enabled",
    "bus": "bus",
}
TYPOS = st.sampled_from(["swap", "drop letter", "double letter", "other letter"])


def misspelt(name, kind, at):
    at = at % (len(name) - 1)
    if kind == "swap":
        return name[:at] + name[at + 1] + name[at] + name[at + 2 :]
    if kind == "drop letter":
        return name[:at] + name[at + 1 :]
    if kind == "double letter":
        return name[:at] + name[at] + name[at:]
    return name[:at] + "q" + name[at + 1 :]


def text_of(columns, mark=",", ending="\n"):
    rows = zip(*columns.values())
    return ending.join([mark.join(columns), *(mark.join(row) for row in rows)]) + ending


def read(data: bytes, name="plane.csv"):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        return read_layout(path)


PLANE = read(text_of(COLUMNS).encode()).plane


def same(plane, besides=()):
    for name in PLANE.__dataclass_fields__:
        if name not in {"name", "address", *besides}:
            assert np.array_equal(getattr(plane, name), getattr(PLANE, name)), name


def encoded(text, encoding, zipped):
    data = text.encode(encoding)
    return gzip.compress(data) if zipped else data


@given(
    order=st.permutations(list(COLUMNS)),
    rows=st.permutations(range(N)),
    upper=st.lists(st.booleans(), min_size=len(COLUMNS), max_size=len(COLUMNS)),
    mark=st.sampled_from([",", ";", "\t", " ", ", "]),
    ending=st.sampled_from(["\n", "\r\n", "\r", "\n\n", "\n# note\n"]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]),
    zipped=st.booleans(),
    flags=st.sampled_from([("True", "False"), ("T", "F"), ("yes", "no"), ("1", "0")]),
)
def test_form_does_not_change_the_plane(order, rows, upper, mark, ending, encoding, zipped, flags):
    columns = {}
    for name, loud in zip(order, upper):
        values = [COLUMNS[name][row] for row in rows]
        if name == "enabled":
            values = [flags[value == "False"] for value in values]
        columns[name.upper() if loud else name] = values
    layout = read(encoded(text_of(columns, mark, ending), encoding, zipped), "plane.dat")
    same(layout.plane)
    assert layout.notices == ()


@given(name=st.sampled_from(list(COLUMNS)), kind=TYPOS, at=st.integers(0, 30))
def test_a_misspelt_column_is_refused_or_named(name, kind, at):
    typo = misspelt(name, kind, at)
    columns = {typo if key == name else key: values for key, values in COLUMNS.items()}
    if typo == name or len(columns) < len(COLUMNS):
        return
    try:
        layout = read(text_of(columns).encode())
    except FormatError as refusal:
        assert typo in str(refusal)
        return
    assert any(typo in notice for notice in layout.notices), layout.notices
    same(layout.plane, {FIELDS[name], "bus"} if name == "id" else {FIELDS[name]})


@given(
    name=st.sampled_from(list(COLUMNS)),
    other=st.text(st.characters(categories=["L", "N"]), min_size=1, max_size=12),
)
def test_a_renamed_column_is_refused_or_named(name, other):
    columns = {other if key == name else key: values for key, values in COLUMNS.items()}
    if len(columns) < len(COLUMNS):
        return
    try:
        layout = read(text_of(columns).encode())
    except FormatError:
        return
    if other.casefold() == name:
        same(layout.plane)
        return
    assert any(other in notice for notice in layout.notices), layout.notices


@given(names=st.sets(st.sampled_from(list(COLUMNS)), min_size=1))
def test_a_dropped_column_is_refused_or_said(names):
    columns = {key: values for key, values in COLUMNS.items() if key not in names}
    if not columns:
        return
    try:
        layout = read(text_of(columns).encode())
    except FormatError as refusal:
        assert any(name in str(refusal) for name in names)
        return
    said = layout.summary + " ".join(layout.notices)
    for name, words in {
        "id": "no column id",
        "phi_range_deg": "range of phi",
        "arm_theta_mm": "arm",
        "arm_phi_mm": "arm",
    }.items():
        assert name not in names or words in said
    if "id" not in names:
        same(layout.plane, {FIELDS[name] for name in names})


@given(
    name=st.sampled_from(list(COLUMNS)),
    row=st.integers(0, N - 1),
    value=st.one_of(
        st.sampled_from(["", "nan", "inf", "1_000", "1,5", "0x10", "1e999", "--", '"', "1 2", "T"]),
        st.text(st.characters(codec="utf-8", exclude_characters="\r\n"), max_size=6),
    ),
)
def test_a_damaged_value_is_refused_or_read_as_it_stands(name, row, value):
    columns = {key: list(values) for key, values in COLUMNS.items()}
    columns[name][row] = value
    try:
        layout = read(text_of(columns).encode())
    except FormatError as refusal:
        assert "plane.csv" in str(refusal)
        return
    if name in ("x_mm", "y_mm"):
        assert float(value) in layout.plane.centers
    elif name != "bus":
        assert value.strip().strip('"').lower() in {
            "t",
            "true",
            "f",
            "false",
            "y",
            "n",
            "yes",
            "no",
        } or (np.isfinite(float(value.strip().strip('"'))))


@given(data=st.binary(max_size=400))
def test_noise_is_refused_with_one_kind_of_error(data):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "noise.csv"
        for start in (
            b"",
            b"\x1f\x8b",
            b"SIMPLE  =",
            b"# %ECSV 1.0\n",
            b"#%yanny\n",
            b"PK\x03\x04",
        ):
            path.write_bytes(start + data)
            for reader in (read_layout, read_targets):
                try:
                    reader(path)
                except FormatError as refusal:
                    assert str(refusal)
