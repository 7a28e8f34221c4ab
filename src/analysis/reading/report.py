"""Report of a reading: which columns were taken and why, the unit, what was left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

# Length of each unit in m, as numerator and denominator: a quotient is rounded once.
UNITS: dict[str, tuple[float, float]] = {
    "m": (1.0, 1.0),
    "dm": (1.0, 10.0),
    "cm": (1.0, 100.0),
    "mm": (1.0, 1000.0),
    "km": (1000.0, 1.0),
    "ft": (0.3048, 1.0),
    "us-ft": (1200.0, 3937.0),
}
NO_NUMBER, ZERO, NOISE, WITHHELD, INVALID = (
    "without a number",
    "0 0 0",
    "noise",
    "withheld",
    "invalid",
)
SINGLE = "the file holds single precision (7 digits)"
WIDE = 1000.0  # m; a scan that is wider may be in mm
FAR = 1e8  # m; no coordinate on the Earth is larger


@dataclass
class Raw:
    """Points as a reader of one format gives them, in the unit of the file.

    unit : of the file, where it states one
    columns : of x, y, z, counted from 1; None where the format fixes them
    """

    points: np.ndarray
    format: str
    columns: tuple[int, ...] | None = None
    why: str = "the format names them"
    unit: str | None = None
    left_out: Counter[str] = field(default_factory=Counter)
    remarks: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Report:
    """Report of a reading, in one line as text.

    format : what the file was taken for
    columns, why : columns of x, y, z, counted from 1, None where the format fixes them; the reason
    unit, unit_from : unit of the file and who says so: "heading", "given" or "assumed"
    points : number of points that were read
    left_out : number of points that were left out, by the reason
    remarks : sentences on what may be wrong
    """

    format: str
    columns: tuple[int, ...] | None
    why: str
    unit: str
    unit_from: str
    points: int
    left_out: dict[str, int]
    remarks: tuple[str, ...]

    def __str__(self) -> str:
        parts = [f"{self.points} points", self.format]
        if self.columns is not None:
            parts.append(f"x y z in columns {shown(self.columns)} ({self.why})")
        parts.append(f"unit {self.unit} ({self.unit_from})")
        if self.left_out:
            listed = ", ".join(f"{count} {reason}" for reason, count in self.left_out.items())
            parts.append(f"left out: {listed}")
        return "; ".join([*parts, *self.remarks])


class Scan(NamedTuple):
    """Points (n, 3) of a file in m, and the report of how they were read."""

    points: np.ndarray
    report: Report


def shown(columns: Iterable[int]) -> str:
    """Columns as the option takes them: 2,3,4."""
    return ",".join(map(str, columns))


def without_missing(points: np.ndarray, left_out: Counter[str]) -> np.ndarray:
    """Points (n, 3) that are returns: neither NaN nor 0 0 0; the others are counted.

    Raises ``ValueError`` for an infinite coordinate, which no format uses for a missing return.
    """
    if np.any(np.isinf(points)):
        first = int(np.argmax(np.isinf(points).any(axis=1))) + 1
        raise ValueError(f"point {first}: expected finite coordinates, got infinity")
    unknown = np.isnan(points).any(axis=1)
    zero = (points == 0.0).all(axis=1)
    for reason, missing in ((NO_NUMBER, unknown), (ZERO, zero)):
        if count := int(np.count_nonzero(missing)):
            left_out[reason] += count
    return points[~(unknown | zero)] if np.any(unknown | zero) else points


def finished(raw: Raw, unit: str | None) -> Scan:
    """Scan in m of what a reader gave; ``unit`` is the caller's, who may not contradict the file.

    Raises ``ValueError`` where no point is left or the units differ.
    """
    if len(raw.points) == 0:
        listed = ", ".join(f"{count} {reason}" for reason, count in raw.left_out.items())
        raise ValueError(f"expected points, the file has none{listed and f': {listed}'}")
    if unit and raw.unit and unit != raw.unit:
        raise ValueError(f"the heading says {raw.unit}, but the unit given is {unit}")
    named = unit or raw.unit or "m"
    numerator, denominator = UNITS[named]
    points = np.ascontiguousarray(raw.points, dtype=np.float64)
    if numerator != 1.0:
        points *= numerator
    if denominator != 1.0:
        points /= denominator
    remarks = list(raw.remarks)
    if (largest := float(np.max(np.abs(points)))) > FAR:
        raise ValueError(
            f"expected coordinates below {FAR:.0e} m, got {largest:.4g}; if the unit "
            "is another, say which (unit mm)"
        )
    extent = float(np.max(np.max(points, axis=0) - np.min(points, axis=0)))
    if unit is None and raw.unit is None and extent > WIDE:
        remarks.append(f"the points spread over {extent:.4g} m; if the file is in mm, say unit mm")
    source = "given" if unit else "heading" if raw.unit else "assumed"
    report = Report(
        raw.format,
        raw.columns,
        raw.why,
        named,
        source,
        len(points),
        dict(raw.left_out),
        tuple(remarks),
    )
    return Scan(points, report)
