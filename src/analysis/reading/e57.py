"""The exchange format of terrestrial scanners, ASTM E2807."""

from pathlib import Path

import numpy as np

AXES = ("cartesianX", "cartesianY", "cartesianZ")


def read_e57(path: Path) -> np.ndarray:
    """Points (n, 3) of all scans of an .e57 file, each moved by its pose into the common frame."""
    import pye57

    file = pye57.E57(str(path))
    try:
        scans = [file.read_scan(i, ignore_missing_fields=True) for i in range(file.scan_count)]
    finally:
        file.close()
    return np.concatenate([np.column_stack([scan[axis] for axis in AXES]) for scan in scans])
