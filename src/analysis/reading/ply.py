"""Stanford's format of polygons, of which the vertices are the points."""

from pathlib import Path

import numpy as np


def read_ply(path: Path) -> np.ndarray:
    """Points (n, 3) of a .ply file; without processing, which would merge points at one place."""
    import trimesh

    return trimesh.load(path, file_type="ply", process=False).vertices
