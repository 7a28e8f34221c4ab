"""Leica's exchange format of structured scans: per scan its size, its frame, and all its cells."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from .lines import Lines, Table, opened
from .report import Raw, without_missing

HEADER = 10  # columns, rows, position, three axes, matrix of four lines
PART = 100_000  # lines


def read_ptx(path: Path) -> Raw:
    """Read the points of all scans of a .ptx file, each moved by its matrix into the common frame.

    A cell without a return is 0 0 0 before the matrix is applied: left out and counted.
    """
    left_out: Counter[str] = Counter()
    parts, scans = [], 0
    with opened(path) as file:
        lines = _numbered(Lines(file))
        for number, line in lines:
            if not line.strip():
                continue
            header = [line, *(text for _, text in _take(lines, HEADER - 1))]
            count, matrix = _header(header, number)
            scans += 1
            table = None
            while count > 0:
                rows = _take(lines, min(count, PART))
                if len(rows) < min(count, PART):
                    raise ValueError(f"scan {scans} is cut: {count - len(rows)} points are missing")
                count -= len(rows)
                text = "\n".join(row for _, row in rows) + "\n"
                table = table or Table(None, ".", len(rows[0][1].split()), (0, 1, 2))
                numbers = table.numbers(text) if table.width in (3, 4, 6, 7) else None
                if numbers is None:
                    raise ValueError(
                        f"lines {rows[0][0]} to {rows[-1][0]}: expected rows x y z intensity"
                    )
                points = without_missing(numbers, left_out)
                parts.append(points @ matrix[:3, :3] + matrix[3, :3])
    points = np.concatenate(parts) if parts else np.empty((0, 3))
    return Raw(points, f"ptx, {scans} scans, each by its matrix", left_out=left_out)


def _numbered(blocks: Lines) -> Iterator[tuple[int, str]]:
    for block in blocks:
        if blocks.unfinished:
            raise ValueError(f"line {blocks.number}: the last line is cut")
        for i, line in enumerate(io.StringIO(block)):
            yield blocks.number + i, line.rstrip("\n")


def _take(lines: Iterator[tuple[int, str]], count: int) -> list[tuple[int, str]]:
    return [pair for _, pair in zip(range(count), lines, strict=False)]


def _header(lines: list[str], number: int) -> tuple[int, np.ndarray]:
    """Number of cells and matrix (4, 4), whose last row is the translation, of one scan."""
    try:
        columns, rows = (int(line) for line in lines[:2])
        numbers = [[float(word) for word in line.split()] for line in lines[2:]]
        matrix = np.array(numbers[4:])
        if [len(row) for row in numbers] != [3] * 4 + [4] * 4 or min(columns, rows) < 1:
            raise ValueError
        turned = matrix[:3, :3] @ matrix[:3, :3].T
        if not np.allclose(turned, np.eye(3), atol=1e-3) or not np.isfinite(matrix).all():
            raise ValueError
    except ValueError:
        raise ValueError(
            f"line {number}: expected the header of a .ptx scan: columns, rows, position, three "
            "axes and a matrix of four lines that turns and moves"
        ) from None
    return columns * rows, matrix
