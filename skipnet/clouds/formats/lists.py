"""Records of a PLY body: tables of numbers, perhaps with lists among the columns."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np

Columns = Sequence[tuple[str, str]]
Table = dict[str, np.ndarray]


def read_binary(
    file: BinaryIO, columns: Columns, lists: Mapping[str, str], order: str, count: int, path: Path
) -> tuple[int, Table]:
    """The next ``count`` records of a binary body.

    Args:
        file: at the first of them.
        columns: name and NumPy kind of each.
        lists: the kind of the number of entries of those that are lists.
        order: "<" or ">".
        count: of records.
        path: for the messages.

    Returns:
        How many records the file still holds, ``count`` at most; and the columns, if it holds all.
    """
    start = file.tell()
    left = os.fstat(file.fileno()).st_size - start
    dtype, lengths = _fixed(file, columns, lists, order)
    file.seek(start)
    if not lists or left >= count * dtype.itemsize:
        if left < count * dtype.itemsize:
            return left // dtype.itemsize, {}
        records = np.frombuffer(file.read(count * dtype.itemsize), dtype, count)
        if all((records[f"count of {name}"] == lengths[name]).all() for name in lists):
            return count, {name: records[name] for name, _ in columns}
        file.seek(start)
    return _read_uneven(file, columns, lists, order, count)


def _fixed(
    file: BinaryIO, columns: Columns, lists: Mapping[str, str], order: str
) -> tuple[np.dtype, dict[str, int]]:
    """What a record is when every list is as long as in the next one."""
    fields: list[tuple] = []
    lengths: dict[str, int] = {}
    for name, kind in columns:
        if name in lists:
            lengths[name] = _number(file, order + lists[name])
            fields += [(f"count of {name}", order + lists[name])]
            fields += [(name, order + kind, (lengths[name],))]
        else:
            fields.append((name, order + kind))
        file.seek(max(0, lengths.get(name, 1)) * np.dtype(kind).itemsize, 1)
    return np.dtype(fields), lengths


def _number(file: BinaryIO, kind: str) -> int:
    """One number of entries; 0 at the file's end, and for what cannot be one."""
    dtype = np.dtype(kind)
    body = file.read(dtype.itemsize)
    if len(body) < dtype.itemsize:
        return 0
    number = float(np.frombuffer(body, dtype)[0])
    left = os.fstat(file.fileno()).st_size - file.tell()
    return int(number) if 0 <= number <= left else 0


def _read_uneven(
    file: BinaryIO, columns: Columns, lists: Mapping[str, str], order: str, count: int
) -> tuple[int, Table]:
    """Records whose lists differ in length, one after the other."""
    kept: dict[str, list] = {name: [] for name, _ in columns}
    for present in range(count):
        for name, kind in columns:
            dtype = np.dtype(order + kind)
            entries = _number(file, order + lists[name]) if name in lists else 1
            body = file.read(entries * dtype.itemsize)
            if len(body) < entries * dtype.itemsize or _at_end_before_last(file, present, count):
                return present, {}
            values = np.frombuffer(body, dtype)
            kept[name].append(values if name in lists else values[0])
    return count, _as_arrays(kept, lists)


def _at_end_before_last(file: BinaryIO, present: int, count: int) -> bool:
    """Whether the file has ended although at least one record, so one byte, is to come."""
    return present + 1 < count and file.tell() >= os.fstat(file.fileno()).st_size


def _as_arrays(kept: dict[str, list], lists: Mapping[str, str]) -> Table:
    table = {}
    for name, values in kept.items():
        if name in lists:
            table[name] = np.empty(len(values), object)
            table[name][:] = values
        else:
            table[name] = np.array(values)
    return table


def read_ascii(
    file: BinaryIO, columns: Columns, lists: Mapping[str, str], order: str, count: int, path: Path
) -> tuple[int, Table]:
    """As ``read_binary``, of a body with one line per record."""
    lines = list(islice(file, count))
    if len(lines) < count or not columns:
        return len(lines), {}
    try:
        if lists:
            return count, _split_lists(lines, columns, lists)
        # Without comments: a line that is counted is a record, whatever it begins with.
        rows = np.loadtxt(lines, ndmin=2, comments=None) if lines else np.empty((0, len(columns)))
    except (ValueError, IndexError) as error:
        message = " ".join(str(error).split())[:120]
        raise ValueError(f"{path}: truncated or damaged records: {message}") from error
    if len(rows) < count or rows.shape[1] != len(columns):
        raise ValueError(
            f"{path}: damaged records: expected {count} lines of {len(columns)} numbers, "
            f"found {len(rows)} of {rows.shape[1]}"
        )
    return count, {name: _cast(rows[:, index], kind) for index, (name, kind) in enumerate(columns)}


def _cast(values: np.ndarray, kind: str) -> np.ndarray:
    """As the column's own kind, where that keeps every value."""
    if kind[0] == "f" or not np.isfinite(values).all():
        return values
    limits = np.iinfo(kind)
    fits = len(values) == 0 or (values.min() >= limits.min and values.max() <= limits.max)
    return values.astype(kind) if fits else values


def _split_lists(lines: list[bytes], columns: Columns, lists: Mapping[str, str]) -> Table:
    kept: dict[str, list] = {name: [] for name, _ in columns}
    for line in lines:
        words = iter(line.split())
        for name, _ in columns:
            number = int(next(words, b"")) if name in lists else 1
            values = np.array([float(word) for word in islice(words, number)])
            if len(values) < number:
                raise ValueError(f"the line {line[:40]!r} ends too early")
            kept[name].append(values if name in lists else values[0])
    return {
        name: values if name in lists else _cast(values, dict(columns)[name])
        for name, values in _as_arrays(kept, lists).items()
    }
