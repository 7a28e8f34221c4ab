"""The exchange format of airborne scans, plain and compressed."""

from __future__ import annotations

import struct
from collections import Counter
from pathlib import Path

import numpy as np

from .report import NOISE, WITHHELD, Raw, without_missing

NOISES = (7, 18)  # classes of the standard: low and high noise
PART = 1_000_000  # points


def read_las(path: Path) -> Raw:
    """Read the points of a .las or .laz file; withheld points and noise are left out and counted.

    What the header claims is checked against the file before memory is taken.
    """
    import laspy

    claimed = _checked(path)
    left_out: Counter[str] = Counter()
    parts, seen = [], 0
    with laspy.open(path) as file:
        for part in file.chunk_iterator(PART):
            seen += len(part)
            withheld = np.asarray(part.withheld, dtype=bool)
            noise = np.isin(np.asarray(part.classification), NOISES) & ~withheld
            for reason, which in ((WITHHELD, withheld), (NOISE, noise)):
                if count := int(np.count_nonzero(which)):
                    left_out[reason] += count
            xyz = np.column_stack([part.x, part.y, part.z])[~(withheld | noise)]
            parts.append(without_missing(xyz, left_out))
    if seen != claimed:
        raise ValueError(f"the header claims {claimed} points, the file holds {seen}")
    points = np.concatenate(parts) if parts else np.empty((0, 3))
    return Raw(points, path.suffix.lower().lstrip("."), left_out=left_out)


def _checked(path: Path) -> int:
    """Number of points that the header claims, after its sizes were checked against the file."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(375)
    if len(head) < 227 or head[:4] != b"LASF":
        raise ValueError("expected the header of a .las file")
    header, offset, records = struct.unpack_from("<HII", head, 94)
    form, length, count = struct.unpack_from("<BHI", head, 104)
    if head[25] >= 4 and len(head) >= 255:
        extended, extensions = struct.unpack_from("<QI", head, 235)
        count = struct.unpack_from("<Q", head, 247)[0]
        if extensions and extended + 60 * extensions > size:
            raise ValueError(f"the header claims {extensions} records beyond the end of the file")
    if not header + 54 * records <= offset <= size:
        raise ValueError(f"the header claims {records} records and points from byte {offset} on")
    # Waveforms and extended records may follow the points, nothing else.
    more = head[6] & 2 or head[25] >= 4 and extensions
    end = offset + length * count
    if not form & 0xC0 and (end > size or end < size and not more):
        raise ValueError(
            f"the header claims {count} points of {length} bytes, {size - offset} bytes follow"
        )
    return count
