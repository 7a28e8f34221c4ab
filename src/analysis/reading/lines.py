"""Text of a file in blocks of whole lines, and rows of numbers of such a block.

A file of any size is read in little memory; what has no line ends is refused before it is read.
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import gzip
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, cast

import numpy as np
import pandas as pd
from tqdm import tqdm

from .columns import MISSING, NUMBER

BLOCK = 1 << 22  # characters
HEAD = 1 << 16  # bytes from which the encoding is seen; no line is longer
NANS = ["nan", "NaN", "NAN", "-nan", "-NaN"]
MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


@contextlib.contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    """Open a file, also a packed one, with progress on a terminal where it takes long."""
    size = path.stat().st_size
    with (
        path.open("rb") as raw,
        tqdm.wrapattr(
            raw,
            "read",
            total=size,
            desc=path.name,
            unit="B",
            unit_scale=True,
            delay=1,
            leave=False,
            disable=None,
        ) as file,
    ):
        packed = path.suffix.lower() == ".gz"
        yield cast(IO[bytes], gzip.GzipFile(fileobj=file) if packed else file)


def encoding_of(head: bytes) -> str:
    """Encoding of a text by its first bytes; raises ``ValueError`` for what is no text."""
    for mark, name in MARKS.items():
        if head.startswith(mark):
            return name
    if b"\0" in head:
        for name, zeros in (("utf-16-le", head[1::2]), ("utf-16-be", head[::2])):
            if zeros.count(0) > 0.9 * len(zeros) and head.count(0) < 0.6 * len(head):
                return name
        raise ValueError("expected text, got bytes that are none")
    try:
        head[: head.rfind(b"\n") + 1 or None].decode("utf-8")
    except UnicodeDecodeError:
        # Chinese headings; else the letters of Western Europe.
        return "gb18030" if re.search("[东北高]", head.decode("gb18030", "ignore")) else "cp1252"
    return "utf-8"


@dataclass
class Lines:
    """Blocks of whole lines of a text, with LF as line end.

    encoding : as found
    number : number of the first line of the latest block, counted from 1
    unfinished : whether the last line has no line end, known at the end
    """

    file: IO[bytes]
    encoding: str = ""
    number: int = 1
    unfinished: bool = False

    def __iter__(self) -> Iterator[str]:
        head = self.file.read(HEAD)
        self.encoding = encoding_of(head)
        rest, following = head, 1
        # A lost byte shifts all of a UTF-16 text; elsewhere a strange letter harms no number.
        errors = "strict" if "16" in self.encoding else "replace"
        decoding = codecs.getincrementaldecoder(self.encoding)(errors=errors)
        decoder = io.IncrementalNewlineDecoder(decoding, translate=True)
        kept = ""
        while True:
            text = kept + decoder.decode(rest, final=not rest)
            if "\0" in text:
                raise ValueError(f"from line {following} on: expected text, got NUL bytes")
            end = text.rfind("\n") + 1
            if not end and len(text) >= HEAD // 4 and rest:
                raise ValueError(f"line {following}: expected a line of text, got one without end")
            self.number, kept = following, text[end:]
            if end:
                yield text[:end]
                following += text.count("\n", 0, end)
            if not rest:
                break
            rest = self.file.read(BLOCK)
        if kept:
            self.number, self.unfinished = following, True
            yield kept


@dataclass(frozen=True)
class Table:
    """Form of the rows of a table.

    separator : of the cells, None for blanks
    mark : the decimal mark
    width : number of cells of a row
    columns : of x, y, z, counted from 0
    decimals : number of decimals in each of these columns, None where it varies
    """

    separator: str | None
    mark: str
    width: int
    columns: tuple[int, int, int]
    decimals: tuple[int | None, ...] = (None, None, None)

    def numbers(self, text: str) -> np.ndarray | None:
        """Numbers (n, 3) of whole lines, read fast; None where a row is not as the others."""
        if not self._even(text):
            return None
        try:
            numbers = pd.read_csv(
                io.StringIO(text),
                sep=r"\s+" if self.separator is None else self.separator,
                header=None,
                usecols=sorted(self.columns),
                dtype=np.float64,
                decimal=self.mark,
                na_values=NANS,
                keep_default_na=False,
                quoting=csv.QUOTE_NONE,
            )[list(self.columns)].to_numpy()
        except ValueError:
            return None
        gaps = self.separator and np.isnan(numbers).any() and self._has_gaps(text)
        return None if gaps or np.isinf(numbers).any() else numbers

    def _has_gaps(self, text: str) -> bool:
        """Tell whether a cell is empty, which is no missing return but a bad row."""
        mark = re.escape(self.separator or "")
        return bool(re.search(rf"(^|{mark})[ \t]*({mark}|$)", text, re.MULTILINE))

    def _even(self, text: str) -> bool:
        """Tell whether every line has the same number of cells, by the places of the bytes."""
        if not text.isascii() or "#" in text or "//" in text or '"' in text or "_" in text:
            return False
        codes = np.frombuffer(text.encode("ascii"), np.uint8)
        ends = np.flatnonzero(codes == 10)
        if self.separator is None:
            cell = codes > 32
            begins = cell.copy()
            begins[1:] &= ~cell[:-1]
            places, expected = np.flatnonzero(begins), self.width
        else:
            places, expected = np.flatnonzero(codes == ord(self.separator)), self.width - 1
        counts = np.diff(np.searchsorted(places, ends), prepend=0)
        return bool(np.all(counts == expected)) and text.endswith("\n")

    def point(self, cells: Sequence[str]) -> tuple[float, ...] | None:
        """Point of the cells of one row; None where it is no row of this table."""
        leading = self.separator is None and set(self.columns) == {0, 1, 2}
        if len(cells) != self.width and not (leading and len(cells) > 2):
            return None
        numbers = []
        for column, decimals in zip(self.columns, self.decimals, strict=True):
            cell = cells[column]
            if MISSING.fullmatch(cell):
                numbers.append(float("nan"))
                continue
            other = "." if self.mark == "," else ","
            if not NUMBER.fullmatch(cell) or other in cell:
                return None
            # A row of another width must look like the others where it is read.
            if len(cells) != self.width and decimals is not None and places(cell) != decimals:
                return None
            numbers.append(float(cell.replace(",", ".")))
        return tuple(numbers)


def places(cell: str) -> int:
    """Number of decimals of a number as it is written."""
    return len(re.split("[eE]", re.split("[.,]", cell)[1])[0]) if re.search("[.,]", cell) else 0


def cells_of(line: str, separator: str | None) -> list[str]:
    """Cells of a line without blanks and quotes around them; a quoted cell may hold separators."""
    if separator is None:
        cells = re.findall(r'"[^"]*"|\S+', line) if '"' in line else line.split()
    elif '"' in line:
        cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    else:
        cells = line.split(separator)
    cells = [cell.strip(" \t\"'\xa0") for cell in cells]
    while len(cells) > 1 and not cells[-1]:
        cells.pop()
    return cells


def shortened(line: str) -> str:
    """Line short enough for a message."""
    return repr(line if len(line) <= 60 else line[:60] + "…")
