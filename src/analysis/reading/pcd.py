"""The format of the Point Cloud Library, ascii and binary."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import IO

from .lines import opened
from .records import read_records, read_rows
from .report import SINGLE, Raw, without_missing

IDENTITY = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]


def read_pcd(path: Path) -> Raw:
    """Read the points of a .pcd file in the frame of its numbers; its viewpoint is not applied."""
    with opened(path) as file:
        header = _header(file)
        left = path.stat().st_size - file.tell()
        try:
            count = int(header["POINTS"][0])
            names, codes, columns = _fields(header)
            moved = [float(word) for word in header.get("VIEWPOINT", ["0"] * 3 + ["1"] + ["0"] * 3)]
        except (KeyError, ValueError, IndexError):
            raise ValueError("expected the header of a .pcd file with fields x y z") from None
        match header["DATA"]:
            case ["ascii"]:
                points = read_rows(file, columns, len(names), count, left)
            case ["binary"]:
                points = read_records(file, dict(zip(names, codes, strict=True)), count, left)
            case _:
                raise ValueError(
                    f"expected ascii or binary points, got {' '.join(header['DATA'])!r}; convert "
                    "with: pcl_convert_pcd_ascii_binary IN OUT 1"
                )
    left_out: Counter[str] = Counter()
    points = without_missing(points, left_out)
    remarks = [SINGLE] if "<f4" in [codes[column] for column in columns] else []
    if moved != IDENTITY:
        remarks.append("the viewpoint of the file is not applied")
    return Raw(points, f"pcd ({header['DATA'][0]})", left_out=left_out, remarks=remarks)


def _header(file: IO[bytes]) -> dict[str, list[str]]:
    """Words of each line of the header, by the first."""
    header: dict[str, list[str]] = {}
    for _ in range(100):
        words = file.readline(1 << 12).decode("latin-1").split()
        if not words or words[0].startswith("#"):
            continue
        header[words[0]] = words[1:]
        if words[0] == "DATA":
            return header
    raise ValueError("expected the header of a .pcd file, found none")


def _fields(header: dict[str, list[str]]) -> tuple[list[str], list[str], tuple[int, int, int]]:
    """Name and numpy's code of every number of a point, and the places of x, y, z."""
    names: list[str] = []
    codes: list[str] = []
    counts = header.get("COUNT", ["1"] * len(header["FIELDS"]))
    described = zip(header["FIELDS"], header["SIZE"], header["TYPE"], counts, strict=True)
    for name, size, kind, count in described:
        code = f"<{ {'F': 'f', 'I': 'i', 'U': 'u'}[kind] }{int(size)}"
        for i in range(int(count)):
            names.append(f"{name} {len(names)}" if name not in "xyz" or i else name)
            codes.append(code)
    x, y, z = (names.index(axis) for axis in "xyz")
    return names, codes, (x, y, z)
