"""The exchange format of terrestrial scanners, ASTM E2807."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from .report import INVALID, Raw, without_missing

AXES = ("cartesianX", "cartesianY", "cartesianZ")


def read_e57(path: Path) -> Raw:
    """Read the points of all scans of an .e57 file, each moved by its pose into the common frame.

    Points marked invalid, and 0 0 0 in the frame of the scanner, are left out and counted.
    """
    import pye57

    left_out: Counter[str] = Counter()
    parts = []
    file = pye57.E57(str(path))
    try:
        for i in range(file.scan_count):
            header = file.get_header(i)
            scan = file.read_scan(i, ignore_missing_fields=True, transform=False)
            points = np.column_stack([scan[axis] for axis in AXES])
            if invalid := header.point_count - len(points):
                left_out[INVALID] += invalid
            points = without_missing(points, left_out)
            if header.has_pose():
                points = file.to_global(points, header.rotation, header.translation)
            parts.append(points)
    finally:
        file.close()
    joined = np.concatenate(parts) if parts else np.empty((0, 3))
    return Raw(joined, f"e57, {len(parts)} scans, each by its pose", left_out=left_out)
