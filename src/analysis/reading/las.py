"""The exchange format of airborne scans, plain and compressed."""

from pathlib import Path

import numpy as np


def read_las(path: Path) -> np.ndarray:
    """Points (n, 3) of a .las or .laz file."""
    import laspy

    return laspy.read(path).xyz
