"""Stanford's format of polygons, of which the vertices are the points."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import IO

from .lines import opened
from .records import read_records, read_rows
from .report import SINGLE, Raw, without_missing

TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def read_ply(path: Path) -> Raw:
    """Read the vertices of a .ply file, which must be its first element."""
    with opened(path) as file:
        form, count, fields, more = _header(file)
        left = path.stat().st_size - file.tell()
        if form == "ascii":
            x, y, z = (list(fields).index(axis) for axis in "xyz")
            points = read_rows(file, (x, y, z), len(fields), count, left, more)
        else:
            typed = {name: ORDERS[form] + code for name, code in fields.items()}
            points = read_records(file, typed, count, left, more)
    left_out: Counter[str] = Counter()
    points = without_missing(points, left_out)
    single = [SINGLE] if "f4" in {fields[axis] for axis in "xyz"} else []
    return Raw(points, f"ply ({form})", left_out=left_out, remarks=single)


def _header(file: IO[bytes]) -> tuple[str, int, dict[str, str], bool]:
    """Format, number of vertices, numpy's code of each property, whether more elements follow."""
    form, count, fields, elements = "", 0, {}, 0
    for number in range(1000):
        words = file.readline(1 << 12).decode("latin-1").split()
        match words:
            case ["ply"] if number == 0:
                pass
            case ["format", name, "1.0"] if name in ORDERS and number:
                form = name
            case ["element", name, claimed] if number and claimed.isdecimal():
                elements += 1
                if elements == 1 and name != "vertex":
                    raise ValueError(f"expected the vertices first, got the element {name!r}")
                count = int(claimed) if elements == 1 else count
            case ["property", kind, name] if elements == 1 and kind in TYPES:
                if name in fields:
                    raise ValueError(f"the header names the property {name!r} twice")
                fields[name] = TYPES[kind]
            case ["property", *_] if elements > 1:
                pass
            case ["comment" | "obj_info", *_] if number:
                pass
            case ["end_header"] if form and set("xyz") <= set(fields):
                return form, count, fields, elements > 1
            case _:
                break
    raise ValueError(f"expected the header of a .ply file with vertices x y z, got {words[:4]!r}")
