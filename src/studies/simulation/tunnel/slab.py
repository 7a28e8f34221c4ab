"""The slab of one section, scanned without the rest of the campaign and drawn many times.

For Monte Carlo studies of sections. Only the beams of the stations that can end in the slab are
cast, as the campaign casts them; their noise is then drawn for many campaigns at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.blocks import BLOCK, pieces
from analysis.scanner import RIEGL_VZ400, Scanner
from analysis.tunnel.sections import THICKNESS

from .alignment import from_nearest
from .campaign import FULL_DENSITY, Setup, cast_beams, station_grid
from .tunnel import Tunnel

SIGHT = 30.0  # m, beyond which the beams of a station meet the lining too obliquely to return
# m before the lining in which the slab's points are sought: bed and catwalk are cut off there
DEPTH = 0.35
NEAR = 1.0  # m from a station to the slab, below which it may be seen all around
ASIDE = np.deg2rad(3.0)  # beyond the springlines: more than the tilts of instrument and section


@dataclass(frozen=True, eq=False)
class SectionScan:
    """The points of one slab in one epoch, without noise, and the root of the cofactors of each.

    chainage : m; epoch : 1 or 2
    points : (n, 3) true points, engineering coordinates in m
    roots : (n, 3, 3) of the cofactors in the same frame: ``roots @ z`` is an error
    codes : (n,) places of the labels in ``NAMES``
    stations : (n,) place of the station, in the order of the set-ups
    """

    chainage: float
    epoch: int
    points: np.ndarray
    roots: np.ndarray
    codes: np.ndarray
    stations: np.ndarray

    def __len__(self) -> int:
        return len(self.codes)

    def __getitem__(self, keep) -> SectionScan:
        """Some of the points, by a mask or by places."""
        arrays = (self.points, self.roots, self.codes, self.stations)
        return SectionScan(self.chainage, self.epoch, *(array[keep] for array in arrays))

    def sample(self, n_points: int, seed: int) -> SectionScan:
        """Draw ``n_points`` of the points without replacement.

        Raises
        ------
        ValueError : there are fewer points.
        """
        if not 1 <= n_points <= len(self):
            most = f"the {len(self)} points of the section"
            raise ValueError(f"n_points: expected from 1 to {most}, got {n_points}")
        return self[np.sort(np.random.default_rng(seed).permutation(len(self))[:n_points])]


def section_scan(
    tunnel: Tunnel,
    setups: Sequence[Setup],
    chainage: float,
    density: float = FULL_DENSITY,
    *,
    thickness: float = THICKNESS,
    scanner: Scanner = RIEGL_VZ400,
) -> SectionScan:
    """Scan the slab around a chainage (m) from the stations of one epoch.

    Parameters
    ----------
    setups : ``survey(…)[epoch − 1].stations``.
    density : beams per station.
    thickness : of the slab, m.

    Raises
    ------
    ValueError : no set-ups, or set-ups of different epochs.

    Example
    -------
    >>> from studies.simulation.tunnel import default_tunnel, survey
    >>> tunnel = default_tunnel()
    >>> section_scan(tunnel, survey(tunnel)[0].stations, 65.0, density=100_000).points.shape[1]
    3
    """
    epochs = {setup.epoch for setup in setups}
    if len(epochs) != 1:
        raise ValueError(f"setups: expected stations of one epoch, got those of {len(epochs)}")
    parts = [
        part
        for place, setup in enumerate(setups)
        if abs(setup.chainage - chainage) < SIGHT
        for part in _slab(tunnel, setup, place, chainage, density, thickness, scanner)
    ]
    empty = (
        np.empty((0, 3)),
        np.empty((0, 3, 3)),
        np.empty(0, dtype=np.uint8),
        np.empty(0, dtype=int),
    )
    return SectionScan(
        chainage,
        epochs.pop(),
        *(np.concatenate(arrays) for arrays in zip(empty, *parts, strict=True)),
    )


def section_points(section: SectionScan, n_trials: int, seed: int) -> np.ndarray:
    """Draw the points of a section with the scanner's noise in B campaigns.

    Trial i draws from the i-th child of ``SeedSequence(seed)``, so it stays unchanged when the
    number of trials grows. Two epochs need two seeds.

    Parameters
    ----------
    section : points without noise, and the roots of their cofactors.
    n_trials : B.
    seed : of the study.

    Returns
    -------
    (B, n, 3) engineering coordinates, m.

    Raises
    ------
    ValueError : a number of trials below 1.
    """
    if not isinstance(n_trials, (int, np.integer)) or n_trials < 1:
        raise ValueError(f"n_trials: expected a whole number of at least 1, got {n_trials!r}")
    clouds = np.empty((n_trials, *section.points.shape))
    for cloud, child in zip(clouds, np.random.SeedSequence(seed).spawn(n_trials), strict=True):
        np.einsum(
            "nij,nj->ni",
            section.roots,
            np.random.default_rng(child).standard_normal(cloud.shape),
            out=cloud,
        )
    clouds += section.points
    return clouds


def _slab(tunnel, setup, place, chainage, density, thickness, scanner):
    """Arrays of a :class:`SectionScan` from one station, block by block.

    Few beams of a block of the station's grid can end in the slab: they are collected before they
    are cast.
    """
    towards = np.concatenate(
        [np.empty((0, 3)), *_towards_the_slab(tunnel, setup, chainage, density, thickness)]
    )
    for part in pieces(len(towards), BLOCK):
        beams, ranges, cosines, codes = cast_beams(tunnel, setup, scanner, towards[part])
        points = setup.pose.to_engineering(ranges[:, None] * beams)
        within = (
            np.abs(tunnel.alignment.section_coordinates(points)[0] - chainage) <= 0.5 * thickness
        )
        roots = setup.pose.rotation @ scanner.roots(beams[within], ranges[within], cosines[within])
        yield (
            points[within],
            roots,
            codes[within].astype(np.uint8),
            np.full(np.count_nonzero(within), place),
        )


def _towards_the_slab(tunnel, setup, chainage, density, thickness):
    """Beams of a station that come within ``DEPTH`` of the lining in the slab, block by block.

    On the way the axis bends as a parabola, as in :mod:`.casting`.
    """
    grid = station_grid(density)
    axis = tunnel.alignment
    start, u_0, v_0 = axis.section_coordinates(setup.pose.position)
    # from the instrument to right, along and up at the station
    to_section = axis.frame(start) @ setup.pose.rotation
    faces = abs(chainage - start) + 0.5 * thickness * np.array([[-1.0], [1.0]])  # near and far
    columns, rows = (
        _columns(tunnel, setup, chainage, thickness, grid.azimuths),
        len(grid.elevations),
    )
    for part in pieces(len(grid), BLOCK):
        if not columns[part.start // rows : (part.stop - 1) // rows + 1].any():
            continue
        beams = grid.beams(part)
        right, towards, up = to_section @ beams.T
        ranges = faces / np.maximum(np.sign(chainage - start) * towards, 1e-3)
        u = u_0 + right * ranges - 0.5 * axis.curvature * (towards * ranges) ** 2
        near, far = np.hypot(u, v_0 + up * ranges)
        yield beams[(near < tunnel.lining.radius + DEPTH) & (far > tunnel.lining.radius - DEPTH)]


def _columns(tunnel, setup, chainage, thickness, azimuths):
    """(columns,) bool: columns of the grid that look at the slab between its springlines.

    From within the slab or near it, all.
    """
    start, _, _ = tunnel.alignment.section_coordinates(setup.pose.position)
    if abs(chainage - start) < 0.5 * thickness + NEAR:
        return np.ones(len(azimuths), dtype=bool)
    face = chainage - 0.5 * thickness * np.sign(chainage - start)
    alpha = np.array([0.0, -0.5, 0.5]) * np.pi
    sights = setup.pose.to_instrument(
        tunnel.alignment.polar_points(face, alpha, tunnel.lining.radius + DEPTH)
    )
    middle, *sides = np.arctan2(sights[:, 1], sights[:, 0])
    half = np.abs(from_nearest(sides - middle, 2 * np.pi)).max()
    return np.abs(from_nearest(azimuths - middle, 2 * np.pi)) < half + ASIDE
