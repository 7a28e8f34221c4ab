"""Ties between the stations of an epoch: the lining that neighbours both see.

Where two stations have points in a cell of the wall, its radius is one and the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ..adjustment.weights import ROUNDED_MAD_TO_SD
from ..blocks import pieces
from ..checks import point_array
from .axis import Axis
from .lining_surface import ROUGHNESS
from .medians import group_medians
from .registration import Station

# m along the tunnel: short, because stations see more of its near side, and rings stand before one
# another
CELL = 0.2
AROUND = 36  # cells around it
REACH = 0.06  # m from the median radius; what is farther away is no lining
# σ from the median of a cell. Stations that are off by 1 σ or 2 must not lose points to one side:
# that would make them agree.
THRESHOLD = 6.0
# Of the incidence angle. More obliquely seen, a wall is its edges: of a step of some millimetres
# the flank, and behind it nothing. With 83°, 22 m in a metro tunnel, neighbours 36 m apart still
# have 8 m of wall in common.
LEAST_COSINE = np.cos(np.deg2rad(83.0))
FEWEST = 5  # points of all stations in a cell, for a median


@dataclass(frozen=True, eq=False)
class Ties:
    """Mean radii of cells of the lining by station, of one epoch.

    A row per cell and station, at least two stations per cell.

    stations : (m,) names
    cells : (m,) numbers of the cells, from 0
    points, normals : (m, 3) middle of the cell on the lining, m, and unit normal outwards, in the
        frame of the project
    radii : (m,) mean radius, m
    counts : (m,) points in the mean
    """

    stations: np.ndarray
    cells: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    radii: np.ndarray
    counts: np.ndarray

    def __len__(self) -> int:
        return len(self.cells)

    @classmethod
    def join(cls, epochs: Sequence[Ties]) -> Ties:
        """Ties of several epochs or of none, their cells numbered on."""
        none, vectors = np.empty(0), np.empty((0, 3))
        nothing = cls(none.astype(str), none.astype(int), vectors, vectors, none, none)
        parts, cells = [nothing], 0
        for of in epochs:
            parts.append(replace(of, cells=of.cells + cells))
            cells += int(of.cells.max(initial=-1)) + 1
        names = [field.name for field in fields(cls)]
        return cls(*(np.concatenate([getattr(of, name) for of in parts]) for name in names))


def surface_ties(
    stations: Mapping[str, Station], scans: Mapping[str, np.ndarray], axis: Axis
) -> Ties:
    """Ties of the stations of one epoch: mean radii of the lining in cells of 0.2 m × 10°.

    Parameters
    ----------
    stations : by name, registered singly
    scans : of the stations of one epoch, by name: points (n, 3) in the frame of the station, m
    axis : of the tunnel; where it lies hardly matters, because only differences of radii are used

    Points more than 6 cm from the median radius of all, and more than 6 σ from the median of their
    cell (all stations, σ from the median of the absolute differences and at least 1 mm), are left
    out; so are cells with fewer than 5 points. A station has no part in a cell that it sees at an
    incidence angle beyond 83°.

    Raises ``ValueError`` for points of a wrong shape, NaN, a single station, and one that is not
    registered.

    >>> from analysis.similarity import fit_similarity
    >>> from analysis.tunnel.axis import straight
    >>> x = np.array([[2.0, 1, 0], [-2, 1, 0], [0, 9, 0], [0, 5, 2]])
    >>> fit = fit_similarity(x, x, scale=False, target_cofactors=0.002**2, absolute=True)
    >>> stations = {name: Station(name, tuple("abcd"), x, x, fit, fit) for name in "12"}
    >>> y, turn = np.arange(20_000) * 5e-4, np.arange(20_000) * 2.4
    >>> tube = np.stack([2.7 * np.sin(turn), y, 2.7 * np.cos(turn)], axis=-1)
    >>> scans = {"1": tube, "2": tube[:10_000]}
    >>> ties = surface_ties(stations, scans, straight([0.0, 0.0, 0.0], [0.0, 10.0, 0.0]))
    >>> len(ties) == 2 * 25 * 36, ties.radii.round(9).min()
    (True, np.float64(2.7))
    """
    if len(scans) < 2:
        raise ValueError(f"scans: expected at least 2 stations of an epoch, got {len(scans)}")
    if unknown := sorted(set(scans) - set(stations)):
        raise ValueError(f"scans: expected those of registered stations, got {', '.join(unknown)}")
    names = np.array(list(scans))
    columns = [
        _rows_and_radii(point_array(points, 3, 1, "ties"), stations[name], axis)
        for name, points in scans.items()
    ]
    station = np.repeat(np.arange(len(names)), [len(radius) for _, _, radius in columns])
    row, column, radius = (np.concatenate(parts) for parts in zip(*columns, strict=True))
    first, middle = row.min(), float(np.median(radius))
    cell = (row - first) * AROUND + column
    lining = _lining(cell, radius, middle)
    key, group, counts = np.unique(
        (cell * len(names) + station)[lining], return_inverse=True, return_counts=True
    )
    radii = middle + np.bincount(group, radius[lining] - middle) / counts
    cell, station = np.divmod(key, len(names))
    points, normals = _middles(axis, cell // AROUND + first, cell % AROUND, radii)
    sight = points - np.array([stations[name].similarity.translation for name in scans])[station]
    plain = np.sum(sight * normals, axis=-1) >= LEAST_COSINE * np.linalg.norm(sight, axis=-1)
    number = np.unique(cell, return_inverse=True)[1]
    tied = plain & (np.bincount(number, plain)[number] >= 2)
    number = np.unique(number[tied], return_inverse=True)[1]
    return Ties(
        names[station[tied]], number, points[tied], normals[tied], radii[tied], counts[tied]
    )


def _rows_and_radii(
    points: np.ndarray, station: Station, axis: Axis
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place of the cell along and around the tunnel, and radius, of points (n, 3) of a station."""
    row, column = np.empty((2, len(points)), dtype=np.int64)
    radius = np.empty(len(points))
    for piece in pieces(len(points)):
        y, radius[piece], angle = axis.polar(station.similarity.transform(points[piece]))
        row[piece] = np.floor(axis.chainage(y) / CELL)
        column[piece] = np.minimum((angle / (2 * np.pi) + 0.5) * AROUND, AROUND - 1)
    return row, column, radius


def _lining(cell: np.ndarray, radius: np.ndarray, middle: float) -> np.ndarray:
    """Numbers of the points that lie on the lining, by the other points of their cell."""
    near = np.flatnonzero(np.abs(radius - middle) <= REACH)
    cell, radius = cell[near], radius[near]
    off = np.abs(radius - group_medians(cell, radius, cell.max() + 1)[cell])
    good = off <= THRESHOLD * np.maximum(
        ROUNDED_MAD_TO_SD * group_medians(cell, off, cell.max() + 1)[cell], ROUGHNESS
    )
    return near[good & (np.bincount(cell)[cell] >= FEWEST)]


def _middles(
    axis: Axis, row: np.ndarray, column: np.ndarray, radii: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Middles of cells on the lining and the normals there, (m, 3)."""
    y = axis.at_chainage((row + 0.5) * CELL)
    right, up, _ = axis.frame(y)
    angle = 2 * np.pi * ((column + 0.5) / AROUND - 0.5)
    normals = np.sin(angle)[:, None] * right + np.cos(angle)[:, None] * up
    return axis.position(y) + radii[:, None] * normals, normals
