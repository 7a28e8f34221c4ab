"""Points in binary records of equal length: what .ply and .pcd share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import IO

import numpy as np

from .lines import Table, shortened

PART = 1 << 20  # records


def read_records(
    file: IO[bytes], fields: Mapping[str, str], count: int, left: int, more: bool = False
) -> np.ndarray:
    """Read x, y, z (count, 3) from records.

    Parameters
    ----------
    file : at the first record
    fields : numpy's code of the type of each field, in order
    count, left : number of records claimed, and of bytes that are there
    more : whether something may follow the records

    Raises
    ------
    ValueError : the file is shorter than claimed, or longer.
    """
    record = np.dtype([(name, code) for name, code in fields.items()])
    size = count * record.itemsize
    if count < 1 or size > left or size < left and not more:
        raise ValueError(
            f"the header claims {count} points of {record.itemsize} bytes, {left} bytes follow"
        )
    points = np.empty((count, 3))
    for start in range(0, count, PART):
        part = points[start : start + PART]
        records = np.frombuffer(file.read(len(part) * record.itemsize), record)
        for axis, name in enumerate("xyz"):
            part[:, axis] = records[name]
    return points


def read_rows(
    file: IO[bytes],
    columns: tuple[int, int, int],
    width: int,
    count: int,
    left: int,
    more: bool = False,
) -> np.ndarray:
    """Read x, y, z (count, 3) from lines of ``width`` cells.

    Raises ``ValueError`` where a line is missing, cut or no row, or lines follow without ``more``.
    """
    if count < 1 or count * 2 * width > left:
        raise ValueError(f"the header claims {count} points, {left} bytes follow")
    table = Table(None, ".", width, columns)
    parts = []
    for start in range(0, count, PART):
        lines = [file.readline(1 << 16) for _ in range(min(PART, count - start))]
        if not lines[-1].endswith(b"\n"):
            raise ValueError(f"the header claims {count} points, the file is cut before its end")
        text = b"".join(lines).decode("latin-1").replace("\r", "")
        numbers = table.numbers(text)
        if numbers is None or len(numbers) != len(lines):
            numbers = np.array([_point(table, i, line) for i, line in enumerate(lines, start + 1)])
        parts.append(numbers)
    if not more and file.read(1 << 16).strip():
        raise ValueError(f"the header claims {count} points, the file holds more")
    return np.concatenate(parts)


def _point(table: Table, number: int, line: bytes) -> tuple[float, ...]:
    text = line.decode("latin-1").strip()
    point = table.point(text.split()) if len(text.split()) == table.width else None
    if point is None:
        raise ValueError(f"point {number}: expected {table.width} numbers, got {shortened(text)}")
    return point
