"""Text: one point per line, with or without headings, comments and further columns.

The form of the table (separator, decimal mark, columns) is found in the head of the file and holds
for all of it; a row that does not fit it is refused with its line.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from .columns import (
    Choice,
    ask,
    axis_and_unit,
    by_heading,
    is_number,
    is_unit,
    show,
    without_heading,
)
from .lines import Lines, Table, cells_of, opened, places, shortened
from .report import Raw, shown, without_missing

SAMPLE = 200  # rows from which the form of the table is found
SEPARATORS = (";", "\t", ",", None)
NAMED = {";": "semicolons", "\t": "tabs", ",": "commas", None: "blanks"}
OTHERS = "ply off coff noff solid ncols nrows lasf version # .pcd".split()


def read_text(path: Path, columns: tuple[int, ...] | None = None) -> Raw:
    """Read the points of a text file; ``columns`` of x, y, z, where told, count from 1."""
    blocks = path.name.lower().removesuffix(".gz").endswith(".pts")
    left_out: Counter[str] = Counter()
    parts: list[np.ndarray] = []
    form: _Form | None = None
    counts: list[tuple[int, int, int]] = []  # line, points announced, points before
    seen = 0
    with opened(path) as file:
        lines = Lines(file)
        for text in lines:
            number = lines.number
            if form is None:
                form = _Form.of(text, columns, blocks)
                if form.count is not None:
                    counts.append((*form.count, 0))
                skipped = form.first - 1
                text = text.split("\n", skipped)[-1] if skipped else text
                number += skipped
            numbers = form.table.numbers(text)
            if numbers is None:
                numbers, found = form.rows(text, number, blocks, lines.unfinished)
                counts += [(line, count, seen + before) for line, count, before in found]
            seen += len(numbers)
            parts.append(without_missing(numbers, left_out))
    if form is None:
        raise ValueError("the file is empty")
    points = np.concatenate(parts)
    remarks = [*form.remarks, *_announced(counts, seen)]
    if lines.unfinished and form.table.columns[-1] == form.table.width - 1:
        remarks.append("the last line has no line end: the file may be cut")
    marked = ", decimal commas" if form.table.mark == "," else ""
    told = f"text ({lines.encoding.removesuffix('-sig')}) with {NAMED[form.table.separator]}"
    taken = tuple(column + 1 for column in form.table.columns)
    return Raw(points, told + marked, taken, form.choice.why, form.choice.unit, left_out, remarks)


def _announced(counts: Sequence[tuple[int, int, int]], total: int) -> list[str]:
    """Sentences on the counts in front of blocks of points."""
    starts = [before for _, _, before in counts[1:]] + [total]
    wrong = [
        f"line {line} announces {count} points, {end - before} follow"
        for (line, count, before), end in zip(counts, starts, strict=False)
        if end - before != count
    ]
    return ([f"{len(counts)} blocks"] if len(counts) > 1 else []) + wrong[:3]


class _Form:
    """Form of a text file, found in its head.

    first : line of the first row, counted from 1
    count : line and number of points announced in front of them, None without
    """

    def __init__(self, first: int, table: Table, choice: Choice, count, remarks):
        self.first, self.table, self.choice = first, table, choice
        self.count, self.remarks = count, remarks

    @classmethod
    def of(cls, head: str, columns: tuple[int, ...] | None, blocks: bool) -> _Form:
        """Find the form in the head of a file."""
        comments, lines = _sample(head)
        separator, rows = _separated(lines)
        split = [(number, line, cells_of(line, separator)) for number, line in lines]
        width = Counter(len(row) for row in rows).most_common(1)[0][0]
        first = next(i for i, (_, _, c) in enumerate(split) if len(c) == width and _is_row(c))
        count, preamble = _preamble(split[:first], blocks)
        body = [cells for _, _, cells in split[first:] if len(cells) == width and _is_row(cells)]
        mark = _decimal_mark(body, separator)
        fitting = [cells_of(line, s) for line in preamble for s in {separator, *_own(line)}]
        fitting = [names for names in fitting if len(names) == width]
        spoken = [c for line in comments if len(c := cells_of(line, separator)) == width]
        choice = _choice(columns, fitting, spoken, preamble, body, separator, mark)
        table = Table(separator, mark, width, choice.columns)
        table = replace(table, decimals=tuple(_decimals(body, i) for i in choice.columns))
        if mark == "," and all(
            re.fullmatch(r"[+-]?[1-9]\d{0,2},\d{3}", row[i]) for row in body for i in choice.columns
        ):
            raise ValueError(
                "the commas may be decimal commas or thousands marks; write the numbers with a "
                f"point or with other than three decimals: {show(body[0])}"
            )
        remarks = []
        names = [axis_and_unit(cell)[0] for cell in fitting[0]] if fitting else []
        if {"x", "y"} <= set(names) and names.index("y") < names.index("x"):
            remarks.append("the heading has y before x: a frame with x to the north is left-handed")
        return cls(split[first][0], table, choice, count, remarks)

    def rows(self, text: str, number: int, blocks: bool, unfinished: bool):
        """Read rows line by line: points (n, 3), and the counts of blocks among them.

        Raises ``ValueError`` for the first line that is no row of the table.
        """
        points: list[tuple[float, ...]] = []
        counts = []
        table = self.table
        lines = text.split("\n")
        for i, line in enumerate(lines):
            line = _bare(line)
            if not line:
                continue
            cells = cells_of(line, table.separator)
            if blocks and len(cells) == 1 and cells[0].isdecimal():
                counts.append((number + i, int(cells[0]), len(points)))
                continue
            point = table.point(cells)
            if point is None:
                taken = ", ".join(str(column + 1) for column in table.columns)
                raise ValueError(
                    f"line {number + i}: expected finite numbers x, y, z in columns {taken} of "
                    f"{table.width}, got {shortened(line)}"
                )
            if unfinished and i == len(lines) - 1 and self._cut(cells):
                raise ValueError(f"line {number + i}: the file is cut in {shortened(line)}")
            points.append(point)
        return np.array(points, dtype=np.float64).reshape(-1, 3), counts

    def _cut(self, cells: Sequence[str]) -> bool:
        """Tell whether a last line without its end lacks cells or decimals that all others have."""
        if len(cells) < self.table.width:
            return True
        return any(
            decimals is not None and column == len(cells) - 1 and places(cells[column]) != decimals
            for column, decimals in zip(self.table.columns, self.table.decimals, strict=True)
        )


def _bare(line: str) -> str:
    """Line without comment and blanks around it."""
    return re.split("#|//", line, maxsplit=1)[0].strip()


def _sample(head: str) -> tuple[list[str], list[tuple[int, str]]]:
    """Comments and the first lines that hold something, with their numbers."""
    comments: list[str] = []
    lines: list[tuple[int, str]] = []
    for number, line in enumerate(head.split("\n"), start=1):
        if line.lstrip().startswith(("#", "//")):
            comments.append(line.strip().lstrip("#/ \t"))
        elif bare := _bare(line):
            lines.append((number, bare))
        if len(lines) >= SAMPLE:
            break
    return comments, lines


def _is_row(cells: Sequence[str]) -> bool:
    return sum(map(is_number, cells)) >= 3


def _separated(lines: Sequence[tuple[int, str]]) -> tuple[str | None, list[list[str]]]:
    """Separator that most lines have, and the rows that it gives."""
    for separator in SEPARATORS:
        rows = [cells for _, line in lines if _is_row(cells := cells_of(line, separator))]
        if rows and 2 * len(rows) >= sum(bool(re.search(r"\d", line)) for _, line in lines):
            return separator, rows
    first = f"line {lines[0][0]}: " if lines else ""
    told = f", the first is {shortened(lines[0][1])}" if lines else ""
    raise ValueError(
        f"{first}expected lines of three numbers x, y, z without thousands marks, found none{told}"
    )


def _own(line: str) -> list[str | None]:
    """Separator of a heading where it differs from that of the rows."""
    return [next((mark for mark in ";\t," if mark in line), None)]


def _preamble(lines, blocks: bool) -> tuple[tuple[int, int] | None, list[str]]:
    """Count and headings in the lines before the first row, which may be nothing else."""
    count = None
    headings = []
    for number, line, cells in lines:
        if cells[0].lower() in OTHERS:
            raise ValueError(f"line {number}: expected rows x y z, got another format: {line!r}")
        if len(cells) == 1 and cells[0].isdecimal() and count is None:
            count = (number, int(cells[0]))
        elif line.lstrip("\"'[(")[:1].isalpha():
            headings.append(re.sub(r"\s+(?=[\[(])", "", line))
        else:
            raise ValueError(
                f"line {number}: expected a heading or three numbers x, y, z, got {shortened(line)}"
            )
    return count, headings


def _decimal_mark(rows: Sequence[Sequence[str]], separator: str | None) -> str:
    """Decimal mark of the numbers in the rows; raises where both marks stand in them."""
    numbers = "".join(cell for row in rows for cell in row if is_number(cell))
    if "," in numbers and "." in numbers:
        raise ValueError(f"decimal points and decimal commas in one table: {show(rows[0])}")
    return "," if "," in numbers else "."


def _decimals(rows: Sequence[Sequence[str]], column: int) -> int | None:
    """Number of decimals in a column where it is the same in all rows that have any."""
    found = {places(row[column]) for row in rows if re.search("[.,]", row[column])}
    return found.pop() if len(found) == 1 and len(rows) > 2 else None


def _choice(columns, fitting, spoken, preamble, rows, separator, mark) -> Choice:
    """Choose the columns: as told, by a heading, by a comment, or without any."""
    width = len(rows[0])
    try:
        named = next(
            (c for n in [*fitting, *spoken] if not any(map(is_unit, n)) and (c := by_heading(n))),
            None,
        )
    except ValueError as error:
        if columns is None:
            raise ask(f"{error}; the first row is {show(rows[0])}") from None
        named = None
    stated = {n[i].lower() for n in fitting if all(map(is_unit, n)) for i in range(width)}
    unit = named.unit if named else None
    unit = unit or (stated.pop() if len(stated) == 1 else None)
    if columns is not None:
        if len(set(columns)) != 3 or not all(1 <= column <= width for column in columns):
            raise ValueError(
                f"expected three columns of 1 to {width}, got {shown(columns)}: {show(rows[0])}"
            )
        a, b, c = (column - 1 for column in columns)
        return Choice((a, b, c), "given", unit)
    if named:
        return replace(named, unit=unit)
    unknown = [names for names in fitting if not all(map(is_unit, names))]
    unknown += [line.split() for line in preamble if _names_axes(line)]
    if unknown:
        raise ask(
            f"the heading {show(unknown[-1])} does not say which of {width} columns are x, y, z; "
            f"the first row is {show(rows[0])}"
        )
    try:
        return replace(without_heading(rows, separator, mark), unit=unit)
    except ValueError as error:
        raise ask(str(error)) from None


def _names_axes(line: str) -> bool:
    """Tell whether words of a line name two axes, though it does not fit the columns."""
    axes = {axis_and_unit(word)[0] for word in re.split(r"[;,\s]+", line) if word}
    return len(axes - {None}) >= 2
