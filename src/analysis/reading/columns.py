"""Columns of x, y and z of a table, and why: by their headings, else by what stands in them.

One rule: what can be read in two ways is refused, with the columns shown and what to pass.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from .report import UNITS, shown

# Names of the axes in the languages of the field; x y z or east north height, not half of each.
NAMES: dict[str, str] = {
    name: axis
    for axis, names in {
        "x": "x",
        "y": "y",
        "z": "z",
        "east": "e east easting eastings ost ostwert rechts rechtswert est este leste öst øst oost"
        " восток 东 東 东坐标 東坐標",
        "north": "n north northing northings nord nordwert hoch hochwert norte noord север 北"
        " 北坐标 北坐標",
        "height": "h height hoehe höhe hohe elev elevation alt altitude level hauteur quota cota"
        " altura höjd høyde højde kote hoogte высота 高 高程",
    }.items()
    for name in names.split()
}
# Words beside an axis that do not change it: x_coord, pos.x, Cartesian X, X-Koordinate.
FILLERS = set("coord coords coordinate koordinate pos position cartesian point p wert".split())
BRACKETS = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]")
ROWS = 3  # rows from which a column can be seen to grow


@dataclass(frozen=True)
class Choice:
    """Columns of x, y, z, counted from 0, the reason, and the unit where a heading states it."""

    columns: tuple[int, int, int]
    why: str
    unit: str | None = None


def is_unit(name: str) -> bool:
    """Tell whether a cell of a heading is the name of a unit."""
    return name.lower() in UNITS


def axis_and_unit(name: str) -> tuple[str | None, str | None]:
    """Return axis and unit of the name of a column: "X [mm]" -> x, mm; None for what is not one."""
    name = name.strip().lower()
    found = BRACKETS.search(name)
    unit = found.group(1) if found else None
    name = BRACKETS.sub("", name)
    name = re.sub(r"^(cartesian|pos|coord)(?=[xyz]$)", "", name)
    if found := re.search(rf"[\s_./]({'|'.join(UNITS)})$", name):
        name, unit = name[: found.start()], found.group(1)
    words = [word for word in re.split(r"[\s_./-]+", name) if word]
    words = [word for word in words if word not in FILLERS] or words
    return (NAMES.get(words[0]) if len(words) == 1 else None), unit


def by_heading(names: Sequence[str]) -> Choice | None:
    """Choose the columns that a heading names; None where it names no x, y and z.

    Raises ``ValueError`` where it names them twice, in part, or in different units.
    """
    found = [axis_and_unit(name) for name in names]
    axes = [axis for axis, _ in found]
    xyz, enh = ("x", "y", "z"), ("east", "north", "height")
    mixed = (("x", "y", "height"), ("east", "north", "z"))
    complete = [family for family in (xyz, enh) if set(family) <= set(axes)]
    complete = complete or [family for family in mixed if set(family) <= set(axes)]
    if not complete:
        if len({axis for axis in axes if axis}) >= 2:
            raise ValueError(f"the heading {show(names)} names not all of x, y, z")
        return None
    family = complete[0]
    if len(complete) > 1 or any(axes.count(axis) > 1 for axis in family):
        raise ValueError(f"the heading {show(names)} names x, y, z twice")
    columns = tuple(axes.index(axis) for axis in family)
    units = {found[column][1] for column in columns}
    if len(units) > 1 or not units <= {None, *UNITS}:
        told = ", ".join(sorted(map(str, units)))
        raise ValueError(f"expected one unit of {' '.join(UNITS)} in the heading, got {told}")
    a, b, c = columns
    named = " ".join(names[column].strip() for column in columns)
    return Choice((a, b, c), f"heading {named!r}", units.pop())


def without_heading(rows: Sequence[Sequence[str]], separator: str | None, mark: str) -> Choice:
    """Choose the columns of a table without a heading: the first three that hold numbers.

    Parameters
    ----------
    rows : first rows of the table, of the same number of cells
    separator, mark : of the cells, None for blanks; the decimal mark

    Raises
    ------
    ValueError : other columns could be x, y, z as well.
    """
    width = len(rows[0])
    cells = list(zip(*rows, strict=True))
    most = len(rows) / 2  # a bad row is refused where it is read, with its line
    numeric = [i for i in range(width) if sum(map(is_number, cells[i])) > most]
    broken = [i for i in numeric if sum(mark in cell for cell in cells[i]) > most]
    whole = [
        i for i in numeric if not any(mark in cell or "e" in cell.lower() for cell in cells[i])
    ]
    first = numeric[:3]
    refused: str | None = None
    if len(first) < 3 or first[2] - first[0] != 2:
        refused = "no three columns of numbers stand side by side"
    elif first[0] > 0 and any(len(set(cells[i])) < len(rows) for i in range(first[0])):
        refused = "words in front are no names of points"
    elif width > 3 and separator == "," and (len(whole) == width or set(first) & set(whole)):
        if len(whole) == width or len(set(broken) - set(first)) > 0:
            refused = "commas may separate cells or decimals"
    if refused is None and len(numeric) > 3:
        if len(broken) >= 3 and not set(first) <= set(broken):
            refused = "whole numbers stand before three columns of decimals"
        elif grows([value(cell) for cell in cells[first[0]]], first[0] in whole):
            refused = f"column {first[0] + 1} only grows, as a number of a point or a time does"
    if refused is None and len(rows) > 1 and set(first) <= set(broken):
        top = [rows[0][i] for i in first]
        if not any(mark in cell for cell in top) and any(abs(value(cell)) > 0.0 for cell in top):
            if all(any(mark in row[i] for i in first) for row in rows[1:]):
                refused = "the first row holds whole numbers, the others do not"
    if refused is not None:
        raise ValueError(f"{refused}: {show(rows[0])}")
    a, b, c = first
    reason = "no heading, the first three" + (" after the names" if a else "")
    return Choice((a, b, c), reason)


def ask(reason: str) -> ValueError:
    """Return the refusal with what to pass."""
    example = shown((2, 3, 4))
    return ValueError(
        f"{reason}; say which columns hold x, y, z, for example columns {example} "
        f"(--columns {example})"
    )


def grows(numbers: Sequence[float], whole: bool) -> bool:
    """Tell whether numbers look like a count or a time: they never fall, and do not stand still."""
    steps = [b - a for a, b in zip(numbers, numbers[1:], strict=False)]
    if len(numbers) < ROWS or not whole and len(numbers) < 10:
        return False
    return all(step > 0 for step in steps) or (
        whole and all(step >= 0 for step in steps) and any(step > 0 for step in steps)
    )


def show(cells: Sequence[str]) -> str:
    """Cells with the number of their columns, short enough for a message."""
    told = " ".join(f"{i}:{cell.strip()[:16]!r}" for i, cell in enumerate(cells[:9], start=1))
    return told + (" …" if len(cells) > 9 else "")


NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?", re.ASCII)
MISSING = re.compile(r"[+-]?nan", re.IGNORECASE)


def is_number(cell: str) -> bool:
    """Tell whether a cell is a number, with a decimal point or comma, or NaN."""
    return bool(NUMBER.fullmatch(cell) or MISSING.fullmatch(cell))


def value(cell: str) -> float:
    """Number in a cell, NaN for what is none."""
    return float(cell.replace(",", ".")) if is_number(cell) else math.nan
