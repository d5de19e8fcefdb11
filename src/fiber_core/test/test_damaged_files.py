# SPDX-License-Identifier: Apache-2.0
"""Damaged problem and plan files: a value or an error of this project, nothing else."""

import random
import warnings
import zipfile

import numpy as np
import pytest

from fiber_core import (
    FiberError,
    Outcome,
    Problem,
    SegmentMotion,
    load_plan,
    load_problem,
    preset,
    save_plan,
    save_problem,
)

CASES = 400  # for each kind of damage and of file
START = np.zeros((7, 2))


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A good file of each kind, and the function that reads it."""
    folder = tmp_path_factory.mktemp("good")
    plane = preset("desi", 7)
    save_problem(folder / "problem.npz", Problem(plane, START, plane.centers + 1.0))
    motion = SegmentMotion(START, np.arange(15), np.ones(14), np.ones(14))
    save_plan(folder / "plan.npz", motion, np.full(7, Outcome.REACHED), np.zeros(7, int))
    return {
        "problem": (folder / "problem.npz", load_problem),
        "plan": (folder / "plan.npz", lambda path: load_plan(path, START)),
    }


def reads(load, path):
    """Return whether a file is read; anything but an error of this project fails the test."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            load(path)
        except FiberError:
            return False
    return True


def flipped(data, rng):
    """Some bits of a file changed, or its end or a part cut off."""
    data = bytearray(data)
    choice = rng.random()
    if choice < 0.15:
        return data[: rng.randrange(len(data))]
    if choice < 0.25:
        begin = rng.randrange(len(data))
        del data[begin : begin + rng.randint(1, 100)]
        return data
    part = min(1500, len(data))
    begin = rng.choice([0, len(data) - part])  # headers and directory more often
    for _ in range(rng.randint(1, 6)):
        at = rng.randrange(len(data)) if choice < 0.5 else begin + rng.randrange(part)
        data[at] ^= 1 << rng.randrange(8)
    return data


def unpacked_flip(path, rng):
    """Bits of an uncompressed array changed, its checksum made again."""
    with zipfile.ZipFile(path) as archive:
        members = {name: bytearray(archive.read(name)) for name in archive.namelist()}
    name = rng.choice(sorted(members))
    data = members[name]
    for _ in range(rng.randint(1, 4)):
        end = 128 if rng.random() < 0.7 else len(data)  # the header of the array more often
        data[rng.randrange(min(end, len(data)))] = rng.randrange(256)
    return members


def changed_array(value, rng):
    """An array of another type, shape or content."""
    value = np.asarray(value)
    changes = [
        lambda: value.astype(str),
        lambda: value.astype(object),
        lambda: np.array({"a": value}, dtype=object),
        lambda: value.astype(complex) if value.dtype.kind in "biuf" else value[..., None],
        lambda: np.zeros(0),
        lambda: value[..., None],
        lambda: np.ravel(value)[:-1],
        lambda: np.array(np.nan),
        lambda: np.array("2026-11-29", "M8[s]"),
        lambda: np.zeros(value.shape, [("a", "i4"), ("b", "f8")]),
        lambda: np.full(value.shape, np.inf),
        lambda: np.full(value.shape, np.nan),
        lambda: np.full(value.shape, -1),
        lambda: np.full(value.shape, 1e300),
        lambda: np.full(value.shape, 2**63, np.uint64),
        lambda: np.full(value.shape, np.iinfo(np.int64).min),
        lambda: np.full(value.shape, 0.5, np.float16),
        lambda: np.zeros((2, 0, 3)),
        lambda: np.array(b"\xff\xfe"),
    ]
    return rng.choice(changes)()


def write_members(path, members):
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, bytes(data))


@pytest.mark.parametrize("kind", ["problem", "plan"])
def test_a_file_with_changed_bits_is_read_or_refused(files, kind, tmp_path):
    rng, refused = random.Random(13), 0
    good, load = files[kind]
    path, data = tmp_path / "damaged.npz", good.read_bytes()
    assert reads(load, good)
    for _ in range(CASES):
        path.write_bytes(flipped(data, rng))
        refused += not reads(load, path)
    assert refused > CASES // 4


@pytest.mark.parametrize("kind", ["problem", "plan"])
def test_an_array_with_changed_bits_is_read_or_refused(files, kind, tmp_path):
    rng, refused = random.Random(14), 0
    good, load = files[kind]
    for _ in range(CASES):
        write_members(tmp_path / "damaged.npz", unpacked_flip(good, rng))
        refused += not reads(load, tmp_path / "damaged.npz")
    assert refused > CASES // 4


@pytest.mark.parametrize("kind", ["problem", "plan"])
def test_an_array_of_another_type_shape_or_range_is_read_or_refused(files, kind, tmp_path):
    rng, refused = random.Random(15), 0
    good, load = files[kind]
    with np.load(good) as file:
        arrays = dict(file)
    for _ in range(CASES):
        damaged = dict(arrays)
        for name in rng.sample(sorted(damaged), rng.randint(1, 2)):
            damaged[name] = changed_array(damaged[name], rng)
        if rng.random() < 0.2:
            del damaged[rng.choice(sorted(damaged))]
        np.savez(tmp_path / "damaged.npz", **damaged)
        refused += not reads(load, tmp_path / "damaged.npz")
    assert refused > CASES // 4


def test_a_file_that_promises_more_than_any_memory_is_refused(files, tmp_path):
    good, load = files["problem"]
    with zipfile.ZipFile(good) as archive:
        members = {name: bytearray(archive.read(name)) for name in archive.namelist()}
    header = members["bus.npy"]
    at = header.index(b"(7,), }")
    header[at : at + 19] = b"(999999999999999,)}"
    write_members(tmp_path / "huge.npz", members)
    assert not reads(load, tmp_path / "huge.npz")


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04", b"\x93NUMPY", b"\x80\x04.", b"\x00" * 99])
def test_a_file_of_another_kind_is_refused(files, data, tmp_path):
    (tmp_path / "other.npz").write_bytes(data)
    for _, load in files.values():
        assert not reads(load, tmp_path / "other.npz")
        assert not reads(load, tmp_path)
        assert not reads(load, tmp_path / "none.npz")
