"""Stanford's format of polygons, of which the vertices are the points."""

from pathlib import Path
from typing import Any

import numpy as np


def read_ply(path: Path) -> np.ndarray:
    """Points (n, 3) of a .ply file; without processing, which would merge points at one place."""
    import trimesh

    geometry: Any = trimesh.load(path, file_type="ply", process=False)
    return geometry.vertices
